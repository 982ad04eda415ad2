//! Describes the status of a stream for the program: what is sent, what is received, and why the current step was
//! chosen.
use serde::Serialize;

use super::{
    ladder::{Change, Reason, Step},
    Group,
};
use crate::video::Settings;

/// The status of a stream.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Status {
    /// Groups that have receivers.
    pub groups: Vec<GroupStatus>,
    /// Receivers that send feedback.
    pub receivers: Vec<ReceiverStatus>,
}

/// The status of a group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupStatus {
    /// The group.
    pub group: Group,
    /// Rate at which frames may be sent, in bytes per second.
    pub bytes_per_s: f64,
    /// Current step. `None` before the first frame, and if the program chooses the size and quality itself.
    pub step: Option<Step>,
    /// Mean size of a frame, in bytes.
    pub frame_bytes: f64,
    /// Frames sent since the stream began.
    pub frames: u64,
    /// Bytes of these frames.
    pub bytes: u64,
    /// How pictures are encoded as video; `None` if they are not.
    pub video: Option<VideoStatus>,
    /// Number of changes of the step.
    pub changes: u64,
    /// Description of the last change.
    pub last_change: Option<String>,
}

/// The status of a video.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VideoStatus {
    /// Rate that the encoder aims for, in bytes per second.
    pub bytes_per_s: f64,
    /// Width and height in quarters of the picture's.
    pub quarters: u8,
    /// Number of key frames since the stream began.
    pub key_frames: u64,
}

impl From<(Settings, u64)> for VideoStatus {
    fn from((settings, key_frames): (Settings, u64)) -> Self {
        Self {
            bytes_per_s: settings.bytes_per_s,
            quarters: settings.quarters,
            key_frames,
        }
    }
}

/// The status of one receiver.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReceiverStatus {
    /// Robot of the receiver.
    pub robot: String,
    /// Number that distinguishes the receivers of the robot.
    pub receiver: u16,
    /// Group of the receiver.
    pub group: Group,
    /// Sequence number of the newest frame that it received.
    pub last: u32,
    /// 90th percentile of the age of frames on arrival, in milliseconds.
    pub age_ms: u32,
    /// Frames received per second.
    pub frames_per_s: f64,
    /// Share of frames that were lost, 0 to 1.
    pub lost_share: f64,
    /// Rate at which frames may be sent to it, in bytes per second.
    pub bytes_per_s: f64,
    /// Pace at which frames arrive, in bytes per second. `None` if it is unknown.
    pub pace_bytes_per_s: Option<u32>,
}

/// Describes a change of the step.
pub(super) fn in_words(change: &Change) -> String {
    let Change {
        from,
        to,
        bytes_per_s,
        ..
    } = change;
    let kb_per_s = bytes_per_s / 1000.0;
    match change.reason {
        Reason::Start => format!("started with {to}: the expected capacity is {kb_per_s:.0} kB/s"),
        Reason::Headroom => {
            format!("from {from} to {to}: the capacity is {kb_per_s:.0} kB/s, more than the step requires")
        }
        Reason::Congestion => {
            format!("from {from} to {to}: the capacity is only {kb_per_s:.0} kB/s")
        }
    }
}
