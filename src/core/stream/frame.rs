//! Defines the frames of a stream: as they arrive, and as the program reads them.
use std::time::Duration;

use crate::core::payload::Payload;

/// A frame that arrived.
#[derive(Clone, Debug, PartialEq)]
pub struct ReceivedFrame {
    /// The picture or value, or a frame of a video, for the [`FrameReader`](super::read::FrameReader).
    pub payload: Payload,
    /// The number of the frame. It starts again when the sender restarts or assigns this receiver to another group.
    pub number: u32,
    /// The age of the frame on arrival. Until the offset of the clocks is known, the delay relative to the fastest frame of
    /// the last minute. `None` if the sender is a stock Zenoh program.
    pub age: Option<Duration>,
    /// The number of frames that were sent since the first one that arrived, including this one.
    pub ordinal: u64,
}

/// A frame that a program reads.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadFrame {
    /// The picture or value. Of a video, the raw picture, or the frame as it was sent if it is left undecoded.
    pub payload: Payload,
    /// The number of the frame.
    pub number: u32,
    /// The age of the frame on arrival.
    pub age: Option<Duration>,
    /// The number of frames between the previous frame that was read and this one.
    pub skipped: u32,
    /// The length of the frame as it was sent, in bytes.
    pub sent_bytes: usize,
}
