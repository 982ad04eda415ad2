//! Limits how often the progress of a transfer is reported to the program.
use std::time::{Duration, Instant};

use super::Progress;

/// The shortest time between two reports.
const PROGRESS_EVERY: Duration = Duration::from_millis(100);

/// Reports each change of the progress once, and at most ten times per second.
#[derive(Debug, Default)]
pub struct ProgressThrottle(Option<(Instant, Progress)>);

impl ProgressThrottle {
    /// Returns the progress if it has changed and a report is due. The `last` report is always due.
    pub fn poll(&mut self, now: Instant, progress: Progress, last: bool) -> Option<Progress> {
        let is_due = self
            .0
            .is_none_or(|(at, _)| last || now.saturating_duration_since(at) >= PROGRESS_EVERY);
        let is_new = self.0.is_none_or(|(_, reported)| reported != progress);
        (is_due && is_new).then(|| {
            self.0 = Some((now, progress));
            progress
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_changes_at_most_ten_times_per_second() {
        let start = Instant::now();
        let mut throttle = ProgressThrottle::default();
        let mut poll = |ms, received_bytes, last| {
            let progress = Progress {
                received_bytes,
                size_bytes: 10,
            };
            throttle
                .poll(start + Duration::from_millis(ms), progress, last)
                .map(|progress| progress.received_bytes)
        };
        assert_eq!(poll(0, 0, false), Some(0));
        assert_eq!(poll(50, 1, false), None, "too early");
        assert_eq!(poll(100, 1, false), Some(1));
        assert_eq!(poll(300, 1, false), None, "unchanged");
        assert_eq!(poll(301, 10, false), Some(10));
        assert_eq!(poll(302, 9, true), Some(9), "the last report is always due");
    }
}
