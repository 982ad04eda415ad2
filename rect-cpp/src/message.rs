//! Converts messages into the form that C receives.
use std::{sync::Arc, time::Instant};

use rect::Name;
use rect_core::clock::unix::ms_since_1970;

use crate::{
    handle::{self, Object},
    payload::PayloadView,
    text::{number, Text},
    urgency::{Urgency, URGENCIES},
};

/// A message from another robot, or from another program of the same robot.
///
/// A message that a function returns has an `id` and is valid until `rect_drop(&message.id, ..)`. A message that is passed
/// to a callback has no `id` and is valid until the callback returns.
#[repr(C)]
pub struct Message {
    /// The handle; 0 in a callback.
    pub id: u64,
    /// The robot that published or sent the message.
    pub sender: Text,
    /// The robot that the message was sent to; empty if it was published.
    pub recipient: Text,
    /// The topic.
    pub topic: Text,
    /// The payload.
    pub payload: PayloadView,
    /// The time of sending by the sender's clock, in milliseconds since 1970; -1 if the sender is a stock Zenoh program. The
    /// clock of a robot without a real-time clock may be wrong by years.
    pub sent_at_ms: i64,
    /// The sequence number that its publisher gave it; -1 if the sender is a stock Zenoh program.
    pub sequence: i64,
    /// Number of messages of the same publisher, directly before this one, that did not arrive.
    pub missed: u32,
    /// Number of messages of the same publisher, directly before this one, that were left out because the subscription asks for fewer.
    pub skipped: u32,
    /// Time until the message expires, in milliseconds, when it was delivered. -1: it does not expire.
    pub expires_in_ms: i64,
    /// Of a retained message, how long ago it was published, in seconds, by the clock of its robot's router; it does not depend on the
    /// time of day. Otherwise NaN.
    pub age_s: f64,
    /// The urgency: a `rect_urgency`.
    pub urgency: u32,
    /// Whether the message arrived after one with a higher sequence number of the same publisher.
    pub late: bool,
    /// Whether the message repeats one of a recording. `sent_at_ms` is the time of that one.
    pub replayed: bool,
    /// Whether the topic is retained (`rect_robot_retained`).
    pub retained: bool,
    /// Whether the program that published a retained message has ended.
    pub has_ended: bool,
    /// Whether the robot has forgotten the retained topic: there is no value any more.
    pub is_forgotten: bool,
    /// The reason why the payload could not be decoded and is as it arrived: it is damaged, or its codec or dictionary is
    /// not available. Also set if the topic was forgotten, so that there is no payload. Otherwise empty.
    pub problem: Text,
    /// The method of the link over which the message arrived, e.g. `ble`. Empty if the sender has several links with this
    /// robot, or if the method is not known.
    pub method: Text,
}

impl Message {
    /// Returns the absence of a message.
    pub fn none() -> Self {
        Self {
            id: 0,
            sender: Text::NONE,
            recipient: Text::NONE,
            topic: Text::NONE,
            payload: PayloadView::EMPTY,
            sent_at_ms: -1,
            sequence: -1,
            missed: 0,
            skipped: 0,
            expires_in_ms: -1,
            age_s: f64::NAN,
            urgency: Urgency::Normal as u32,
            late: false,
            replayed: false,
            retained: false,
            has_ended: false,
            is_forgotten: false,
            problem: Text::NONE,
            method: Text::NONE,
        }
    }
}

/// A message together with the text that its C form points to.
struct OwnedMessage {
    message: rect::Message,
    problem: Option<String>,
}

impl Object for OwnedMessage {
    const KIND: &'static str = "message";
}

/// Returns the text of the reason why a message could not be decoded.
pub fn problem(message: &rect::Message) -> Option<String> {
    message.problem().map(ToString::to_string)
}

/// Returns the C form of a message, which is valid as long as the message and `problem`.
pub fn view(message: &rect::Message, problem: Option<&str>) -> Message {
    let sent_at_ms = message.sent_at.map(ms_since_1970);
    let retained = message.retained;
    Message {
        id: 0,
        sender: Text::of(message.sender.as_str()),
        recipient: Text::of_some(message.recipient.as_ref().map(Name::as_str)),
        topic: Text::of(message.topic.as_str()),
        payload: PayloadView::of(&message.payload),
        sent_at_ms: sent_at_ms.map_or(-1, |ms| i64::try_from(ms).unwrap_or(i64::MAX)),
        sequence: message.sequence.map_or(-1, i64::from),
        missed: message.missed,
        skipped: message.skipped,
        expires_in_ms: message.expires_at.map_or(-1, |at| {
            let rest = at.saturating_duration_since(Instant::now());
            i64::try_from(rest.as_millis()).unwrap_or(i64::MAX)
        }),
        age_s: retained.map_or(f64::NAN, |retained| retained.age.as_secs_f64()),
        urgency: number(&URGENCIES, &message.urgency),
        late: message.late,
        replayed: message.replayed,
        retained: retained.is_some(),
        has_ended: retained.is_some_and(|retained| retained.has_ended),
        is_forgotten: message.is_forgotten(),
        problem: Text::of_some(problem),
        method: Text::of_some(message.method.as_deref()),
    }
}

/// Moves a message into the handle table and returns its C form.
pub fn into_c(message: rect::Message) -> Message {
    let problem = problem(&message);
    let owned = Arc::new(OwnedMessage { message, problem });
    let view = view(&owned.message, owned.problem.as_deref());
    let id = handle::insert_shared(owned);
    Message { id, ..view }
}
