//! Owns messages as C gets them.
use std::sync::Arc;

use rect::Name;

use crate::{
    handle::{self, Object},
    payload::PayloadView,
    robot::URGENCIES,
    text::{number, Text},
};

/// A message from another robot (or another program of this one). One that a call gives has an `id`, and is there until
/// `rect_drop(&message.id, ..)`. One that a callback is called with has none, and is there until the callback returns.
#[repr(C)]
pub struct Message {
    /// Its handle; 0 in callbacks.
    pub id: u64,
    /// Who sent it.
    pub from: Text,
    /// To whom alone; nothing: to all.
    pub to: Text,
    /// About what.
    pub topic: Text,
    /// What it says.
    pub payload: PayloadView,
    /// When, by the sender's clock, in ms since 1970; -1 for one of a stock program. A robot without a clock of its own may
    /// be years off.
    pub sent_ms: i64,
    /// Its number at its publisher; -1 for one of a stock program.
    pub sequence: i64,
    /// So many of its publisher, before it, did not arrive.
    pub missed: u32,
    /// How urgent: a `rect_urgency`.
    pub urgency: u32,
    /// It was overtaken on its way.
    pub late: bool,
    /// Why it is still packed as it came, if it is: it is damaged, or of a codec that is not known here.
    pub flaw: Text,
    /// By what it came, as `ble`, where its sender has one link with this robot, and that is known.
    pub over: Text,
}

/// A message, and what its parts point to.
struct Held {
    message: rect::Message,
    flaw: Option<String>,
}

impl Object for Held {
    const KIND: &'static str = "message";
}

/// Why a message is still packed, in words.
pub fn flaw(message: &rect::Message) -> Option<String> {
    message.flaw.as_ref().map(ToString::to_string)
}

/// As C gets it; it lives as long as the message and the words for its flaw.
pub fn view(message: &rect::Message, flaw: Option<&str>) -> Message {
    let sent_ms = message
        .sent_ms
        .map(|ms| i64::try_from(ms).unwrap_or(i64::MAX));
    Message {
        id: 0,
        from: Text::of(message.from.as_str()),
        to: Text::of_some(message.to.as_ref().map(Name::as_str)),
        topic: Text::of(message.topic.as_str()),
        payload: PayloadView::of(&message.payload),
        sent_ms: sent_ms.unwrap_or(-1),
        sequence: message.sequence.map_or(-1, i64::from),
        missed: message.missed,
        urgency: number(&URGENCIES, &message.urgency),
        late: message.late,
        flaw: Text::of_some(flaw),
        over: Text::of_some(message.over.as_deref()),
    }
}

/// Gives C a message.
pub fn hold(message: rect::Message) -> Message {
    let flaw = flaw(&message);
    let held = Arc::new(Held { message, flaw });
    let view = view(&held.message, held.flaw.as_deref());
    let id = handle::insert_shared(held);
    Message { id, ..view }
}
