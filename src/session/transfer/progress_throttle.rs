//! Limits how often progress is reported to the program.
use std::time::{Duration, Instant};

use crate::core::transfer::Progress;

/// Shortest interval between two reports.
const PROGRESS_EVERY: Duration = Duration::from_millis(100);

/// Reports changed progress at most every [`PROGRESS_EVERY`]; holds the last report and its time.
#[derive(Default)]
pub(super) struct ProgressThrottle(Option<(Instant, Progress)>);

impl ProgressThrottle {
    /// Calls `callback` if the progress has changed and a report is due. The `last` report is always due.
    pub(super) fn report(
        &mut self,
        progress: Progress,
        last: bool,
        mut callback: impl FnMut(Progress),
    ) {
        let now = Instant::now();
        let due = self
            .0
            .is_none_or(|(at, _)| last || now.duration_since(at) >= PROGRESS_EVERY);
        let is_new = self.0.is_none_or(|(_, reported)| reported != progress);
        if due && is_new {
            self.0 = Some((now, progress));
            callback(progress);
        }
    }
}
