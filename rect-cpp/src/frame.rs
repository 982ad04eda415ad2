//! Owns frames of streams as C gets them.
use std::sync::Arc;

use crate::{
    handle::{self, Object},
    payload::PayloadView,
};

/// A frame of a stream. One that a call gives has an `id`, and is there until `rect_drop(&frame.id, ..)`. One that a callback
/// is called with has none, and is there until the callback returns.
#[repr(C)]
pub struct Frame {
    /// Its handle; 0 in callbacks.
    pub id: u64,
    /// What it is.
    pub payload: PayloadView,
    /// How old it was when it came, in us; until the sender has told its time, how much older than the fastest of the last
    /// minute. -1: another program's, which does not tell.
    pub age_us: i64,
    /// Its number. The sender numbers anew when it starts, and when this robot gets other frames than before.
    pub number: u32,
    /// So many before it were not seen: the link dropped them, or this program was not there to take them.
    pub skipped: u32,
}

struct Held(rect::Frame);

impl Object for Held {
    const KIND: &'static str = "frame";
}

/// As C gets it; it lives as long as the frame.
pub fn view(frame: &rect::Frame) -> Frame {
    let age_us = frame.age.map(|age| age.as_micros());
    Frame {
        id: 0,
        payload: PayloadView::of(&frame.payload),
        age_us: age_us.map_or(-1, |age| i64::try_from(age).unwrap_or(i64::MAX)),
        number: frame.number,
        skipped: frame.skipped,
    }
}

/// Gives C a frame.
pub fn hold(frame: rect::Frame) -> Frame {
    let held = Arc::new(Held(frame));
    let view = view(&held.0);
    let id = handle::insert_shared(held);
    Frame { id, ..view }
}
