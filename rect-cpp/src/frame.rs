//! Converts frames of streams into the form that C receives.
use std::sync::Arc;

use crate::{
    handle::{self, Object},
    payload::PayloadView,
};

/// A frame of a stream.
///
/// A frame that a function returns has an `id` and is valid until `rect_drop(&frame.id, ..)`. A frame that is passed to a
/// callback has no `id` and is valid until the callback returns.
#[repr(C)]
pub struct Frame {
    /// The handle; 0 in a callback.
    pub id: u64,
    /// The payload. A frame of a video is decoded: the payload is the raw picture.
    pub payload: PayloadView,
    /// The age of the frame on arrival, in microseconds. Until the offset of the sender's clock is known, this is the delay
    /// relative to the fastest frame of the last minute. -1 if the sender is a stock Zenoh program.
    pub age_us: i64,
    /// The number of the frame. Numbering restarts when the sender restarts, and when this robot joins another group of
    /// receivers.
    pub number: u32,
    /// Number of frames directly before this one that the program did not receive: the link or the receive queue dropped
    /// them.
    pub skipped: u32,
    /// Number of these that did not arrive.
    pub lost: u32,
    /// The length of the frame as it was sent, in bytes.
    pub sent_bytes: usize,
}

struct OwnedFrame(rect::Frame);

impl Object for OwnedFrame {
    const KIND: &'static str = "frame";
}

/// Returns the C form of a frame, which is valid as long as the frame.
pub fn view(frame: &rect::Frame) -> Frame {
    let age_us = frame.age.map(|age| age.as_micros());
    Frame {
        id: 0,
        payload: PayloadView::of(&frame.payload),
        age_us: age_us.map_or(-1, |age| i64::try_from(age).unwrap_or(i64::MAX)),
        number: frame.number,
        skipped: frame.skipped,
        lost: frame.lost,
        sent_bytes: frame.sent_bytes,
    }
}

/// Moves a frame into the handle table and returns its C form.
pub fn into_c(frame: rect::Frame) -> Frame {
    let owned = Arc::new(OwnedFrame(frame));
    let view = view(&owned.0);
    let id = handle::insert_shared(owned);
    Frame { id, ..view }
}
