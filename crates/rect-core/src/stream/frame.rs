//! Defines the frames of a stream: as they arrive, and as the program reads them.
use std::time::Duration;

use crate::message::payload::Payload;

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
    /// The number of those that did not arrive.
    pub lost: u64,
}

/// A frame of a stream, as the program reads it.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The picture or value. A frame of a video is decoded: the payload is the raw picture ([`Payload::picture`]), unless the
    /// program decodes it.
    pub payload: Payload,
    /// The number of the frame. It starts again when the sender restarts or assigns this receiver to another group.
    pub number: u32,
    /// The age of the frame on arrival. Until the offset of the clocks is known, the delay relative to the fastest frame of
    /// the last minute. `None` if the sender is a stock Zenoh program.
    pub age: Option<Duration>,
    /// The number of frames between the previous frame that the program read and this one. The link dropped them, or
    /// newer frames replaced them in the receive queue.
    pub skipped: u32,
    /// The part of the skipped frames that did not arrive.
    pub lost: u32,
    /// The length of the frame as it was sent, in bytes.
    pub sent_bytes: usize,
}
