//! Owns the telling of progress: each news once, and not too often.
use std::time::{Duration, Instant};

use crate::core::transfer::Progress;

/// How often progress is told at most.
const PROGRESS_EVERY: Duration = Duration::from_millis(100);

/// What was told of the progress.
#[derive(Default)]
pub(super) struct Told(Option<(Instant, Progress)>);

impl Told {
    /// Tells it if it is another, and not too soon after the last time; the last one in any case.
    pub(super) fn tell(
        &mut self,
        progress: Progress,
        last: bool,
        mut callback: impl FnMut(Progress),
    ) {
        let now = Instant::now();
        let due = self
            .0
            .is_none_or(|(at, _)| last || now.duration_since(at) >= PROGRESS_EVERY);
        let is_new = self.0.is_none_or(|(_, told)| told != progress);
        if due && is_new {
            self.0 = Some((now, progress));
            callback(progress);
        }
    }
}
