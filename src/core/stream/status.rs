//! Owns what a program may know of its stream: what goes out, what gets through, and why it is as it is.
use serde::Serialize;

use super::{
    ladder::{Change, Level, Why},
    Group,
};

/// What is known of a stream.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Status {
    /// What goes out, by group; those that have anyone.
    pub groups: Vec<GroupStatus>,
    /// Who says that it listens.
    pub receivers: Vec<ReceiverStatus>,
}

/// What goes out to a group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupStatus {
    /// Which.
    pub group: Group,
    /// What may be sent, in bytes per second.
    pub bytes_per_s: f64,
    /// The step; `None`: the program's own choice.
    pub level: Option<Level>,
    /// What its frames take, in bytes.
    pub frame_bytes: f64,
    /// Frames that went, since the stream began.
    pub frames: u64,
    /// Their bytes.
    pub bytes: u64,
    /// How often the step has changed.
    pub changes: u64,
    /// The last change, in words.
    pub last_change: Option<String>,
}

/// What one program says that it gets.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReceiverStatus {
    /// Whose program.
    pub robot: String,
    /// Which of its programs.
    pub receiver: u16,
    /// Where it listens.
    pub group: Group,
    /// The number of the newest frame it has.
    pub last: u32,
    /// 9 of 10 frames are not older there, in milliseconds.
    pub age_ms: u32,
    /// Frames per second that come there.
    pub frames_per_s: f64,
    /// The share of frames that do not.
    pub lost_share: f64,
    /// What may be sent to it, in bytes per second.
    pub bytes_per_s: f64,
    /// How fast frames come through, in bytes per second, where known.
    pub pace_bytes_per_s: Option<u32>,
}

/// A change in words.
pub(super) fn in_words(change: &Change) -> String {
    let Change {
        from,
        to,
        bytes_per_s,
        ..
    } = change;
    let kb_per_s = bytes_per_s / 1000.0;
    match change.why {
        Why::Begins => format!("began with {to}: {kb_per_s:.0} kB/s are expected to get through"),
        Why::Room => {
            format!("from {from} to {to}: {kb_per_s:.0} kB/s get through, more than that needs")
        }
        Why::Tight => format!("from {from} to {to}: only {kb_per_s:.0} kB/s get through"),
    }
}
