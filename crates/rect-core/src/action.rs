//! Actions: long tasks of a program, such as driving to a place, with progress, cancel and one end.
//!
//! They stand on what there is. An action is a service with an internal topic, which stands in the catalogue; starting a goal and
//! cancelling it are requests to it ([`order`]). The state of a goal ([`state`]) is a retained message on the topic
//! `actions/<action>/<goal>`, so that the robot's router keeps it, a cut does not matter, and others find the goal. Feedback is a message
//! on `actions/<action>/<goal>/feedback`. A large [`result`] stays with its program, and is requested in pieces, as a transfer is.
//! [`server`] decides for the program that carries out goals, and [`run`] for the one that follows a goal.
pub mod order;
pub mod pull;
pub mod query;
pub mod result;
pub mod results;
pub mod run;
pub mod server;
pub mod state;
#[cfg(test)]
mod tests;

use std::time::Duration;

use serde::Serialize;

use self::state::Phase;
use crate::{
    message::{
        encoding::Encoding,
        payload::{Cbor, Payload, ToPayload},
    },
    name::parameter::{is_name, wrong_name},
    text::display::is_harmful,
};

/// The part of a topic that precedes the name of an action.
pub const TOPIC: &str = "actions";
/// The part of a topic that follows a goal, for its feedback.
const FEEDBACK: &str = "feedback";
/// How long the state of a goal is kept after its end.
pub const KEPT_FOR: Duration = Duration::from_secs(600);
/// The maximum number of goals of an action that have ended and are kept.
pub const MAX_KEPT: usize = 16;
/// The maximum size of a goal, feedback or a result that is part of a state, in bytes.
pub const MAX_VALUE: usize = 48 << 10;
/// The maximum size of a result, in bytes.
pub const MAX_RESULT: usize = 16 << 20;
/// The maximum length of a reason, in characters.
pub const MAX_REASON: usize = 300;
/// The size up to which an end is urgent, in bytes.
pub const URGENT_END: usize = 512;
/// How long a client has to be away by default until its goal is cancelled.
pub const LOST_AFTER: Duration = Duration::from_secs(5);
/// How often feedback is sent at most by default, per second.
pub const FEEDBACK_PER_S: f64 = 10.0;

/// Returns the topic of the state of a goal. `*` may take the place of the action and the goal.
pub fn topic(action: &str, goal: &str) -> String {
    format!("{TOPIC}/{action}/{goal}")
}

/// Returns the topic of the feedback of a goal.
pub fn feedback_topic(action: &str, goal: &str) -> String {
    format!("{}/{FEEDBACK}", topic(action, goal))
}

/// Returns the action and the goal of the topic of a state. `None` for every other topic.
pub fn of_topic(topic: &str) -> Option<(&str, &str)> {
    let rest = topic.strip_prefix(TOPIC)?.strip_prefix('/')?;
    let (action, goal) = rest.split_once('/')?;
    (is_name(action) && is_name(goal)).then_some((action, goal))
}

/// Returns the error that a text cannot name an action.
pub fn wrong_action(action: &str) -> String {
    wrong_name(action, "the name of an action")
}

/// Returns the error that a goal has ended without being done, or that there is no result although it is.
pub fn goal_ended(phase: Phase, reason: &str) -> String {
    let end = match phase {
        Phase::Failed => "failed",
        Phase::Lost => "is lost",
        Phase::Refused => "was refused",
        Phase::Preempted => "was preempted",
        Phase::Cancelled => "was cancelled",
        Phase::Done => return format!("the goal is done, but {reason}"),
        phase => phase.as_str(),
    };
    match reason {
        "" => format!("the goal {end}"),
        reason => format!("the goal {end}: {reason}"),
    }
}

/// Returns the id of a goal that is made of a random number.
pub fn goal_id(random: u64) -> String {
    format!("{random:016x}")
}

/// Returns a value of a program as CBOR, in which it is part of a message.
///
/// # Errors
/// Returns why it cannot be.
pub fn to_value(payload: &Payload) -> Result<ciborium::Value, String> {
    if payload.bytes.len() > MAX_VALUE {
        return Err(format!(
            "the value has {} bytes, and at most {MAX_VALUE} are allowed: send larger ones as a transfer, and its name here",
            payload.bytes.len()
        ));
    }
    let value = payload.value::<ciborium::Value>();
    // An empty text is one, and nothing else is nothing.
    Ok(value.unwrap_or_else(|_| match payload.bytes.is_empty() {
        true => ciborium::Value::Null,
        false => ciborium::Value::Bytes(payload.bytes.to_vec()),
    }))
}

/// Does the same as [`to_value`] for a value that a program need not give: an empty payload is null.
///
/// # Errors
/// Returns why it cannot be.
pub fn to_optional_value(payload: &Payload) -> Result<ciborium::Value, String> {
    match payload.bytes.is_empty() {
        true => Ok(ciborium::Value::Null),
        false => to_value(payload),
    }
}

/// Returns the payload of a value that is part of a message.
pub fn to_payload(value: &ciborium::Value) -> Payload {
    match value {
        ciborium::Value::Bytes(bytes) => Payload::new(bytes.clone(), Encoding::BYTES),
        value => cbor(value),
    }
}

/// Returns the value that a document does not contain.
fn null() -> ciborium::Value {
    ciborium::Value::Null
}

/// Returns something as CBOR that can always be serialized.
fn cbor(document: &impl Serialize) -> Payload {
    let payload = Cbor(document).to_payload();
    payload.unwrap_or_else(|_| Payload::new("", Encoding::CBOR))
}

/// Returns a text without control characters, and not too long.
fn short(text: &str) -> String {
    let printable = |c: &char| !is_harmful(*c) || *c == '\n';
    text.trim()
        .chars()
        .filter(printable)
        .take(MAX_REASON)
        .collect()
}
