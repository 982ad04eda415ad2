//! Records the lines that programs log.
use std::time::Duration;

use rect_core::{log::page::Kept, message::urgency::Urgency, name::Name};

use super::Recorder;
use crate::{
    entry::Entry,
    log::{message, missed, LOG},
};

impl Recorder {
    /// Records a line that a program of `robot` has logged.
    pub fn on_line(&self, robot: &Name, kept: &Kept) {
        self.add(entry(robot, kept, self.now()));
    }

    /// Records that lines of `robot` were missed.
    pub fn on_missed_lines(&self, robot: &Name) {
        let now = self.now();
        let now_ms = u64::try_from(now.as_millis()).unwrap_or(u64::MAX);
        self.add(entry(robot, &missed(now_ms), now));
    }
}

/// Returns the entry of a line that arrived at a time.
fn entry(robot: &Name, kept: &Kept, logged: Duration) -> Entry {
    Entry {
        urgency: Urgency::Bulk,
        sent: Duration::from_millis(kept.line.at),
        ..Entry::of_report(robot, LOG, message(kept), logged)
    }
}
