//! The questions that programs and routers ask a router about state, and its answers, in CBOR.
use std::time::Duration;

use bytes::Bytes;
use serde::{de::DeserializeOwned, Deserialize, Serialize};
use zenoh_keyexpr::{keyexpr, OwnedKeyExpr};

use super::{Origin, Position, Retained, MAX_ROBOT, MAX_VALUE};
use crate::{
    message::{
        attachment::Sent,
        encoding::Encoding,
        payload::{Payload, PayloadError},
        urgency::Urgency,
        Message,
    },
    name::{topic::Topic, Name},
};

/// The maximum number of key expressions in a question.
pub const MAX_KEYS: usize = 256;
/// The size at which a page ends, in bytes. Its last value may exceed it.
pub(super) const PAGE: usize = 16 << 10;
/// The maximum size of a question or a page, in bytes.
const MAX_BYTES: usize = PAGE + MAX_VALUE + MAX_ROBOT;

const HAS_ENDED: u8 = 1;
const IS_FORGOTTEN: u8 = 2;
const IS_URGENT: u8 = 4;
const IS_BULK: u8 = 8;

/// A question to the router of another robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Question {
    /// What has changed?
    #[serde(rename = "s")]
    Since {
        /// The robot that asks. The router tells it of later changes that it has not received.
        #[serde(rename = "b", default, skip_serializing_if = "Option::is_none")]
        by: Option<String>,
        /// Whether it has other topics beside these.
        #[serde(rename = "a", default, skip_serializing_if = "std::ops::Not::not")]
        adds: bool,
        /// The position up to which it knows everything; `None`: it knows nothing.
        #[serde(rename = "p", default, skip_serializing_if = "Option::is_none")]
        since: Option<Position>,
        /// The key expressions of the topics.
        #[serde(rename = "k")]
        keys: Vec<String>,
    },
    /// Do you have the values of this robot as they are now?
    #[serde(rename = "c")]
    Check {
        /// The robot whose values it is about.
        #[serde(rename = "b")]
        of: String,
        /// The position of the last change.
        #[serde(rename = "p")]
        at: Position,
        /// A checksum of the numbers of its values that the other robot subscribes to, and of the key expressions.
        #[serde(rename = "d")]
        digest: u64,
        /// Whether a value that is not there is forgotten.
        #[serde(rename = "f")]
        is_complete: bool,
    },
}

/// A question or an order of a program to its own router.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Order {
    /// Keep a value, and publish it.
    Set {
        /// The topic.
        topic: String,
        /// The identity of the value.
        origin: Origin,
        /// When it was published, in milliseconds since 1970.
        sent_ms: u64,
        /// Its position at an earlier run of the router, if that had it. Then it is not published again.
        kept: Option<Position>,
        /// How many milliseconds ago it was published.
        age_ms: u64,
        /// The urgency of the message.
        urgency: Urgency,
        /// Whether to keep it on disk.
        disk: bool,
        /// The encoding of the value.
        encoding: String,
        /// The value.
        bytes: Bytes,
    },
    /// Forget a topic.
    Forget {
        /// The topic.
        topic: String,
        /// The identity of the change.
        origin: Origin,
        /// When it was forgotten, in milliseconds since 1970.
        sent_ms: u64,
    },
    /// What has changed? The answer waits until something has, and for [`POLL`](super::program::POLL) at most.
    Poll {
        /// The run of the program.
        program: u32,
        /// The position up to which it knows everything; `None`: it knows nothing.
        since: Option<Position>,
        /// The key expressions of the topics.
        keys: Vec<String>,
    },
    /// Which values are kept of these topics now?
    Latest {
        /// The key expression of the topics.
        key: String,
    },
}

/// The answer to [`Order::Set`] and [`Order::Forget`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Kept {
    /// The position of the value.
    pub at: Position,
    /// A problem that the program should know.
    pub warning: Option<String>,
}

/// A part of the answer to a question: values in the order of their numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Page {
    /// The run of the router that answers.
    #[serde(rename = "r")]
    pub run: u32,
    /// The number up to which everything is known with this page.
    #[serde(rename = "n")]
    pub at: u64,
    /// Whether there is more after it.
    #[serde(rename = "m")]
    pub more: bool,
    /// The robots whose values are complete up to a position at their routers, so that those that no page of this run contained are
    /// forgotten. The router's own robot has no name here.
    #[serde(rename = "c")]
    pub complete: Vec<(String, Position)>,
    /// The values.
    #[serde(rename = "v")]
    pub records: Vec<Value>,
}

/// A value of a page.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "Wire", try_from = "Wire")]
pub struct Value {
    /// The robot; `None`: that of the router which answers.
    pub robot: Option<Name>,
    /// The topic.
    pub topic: Topic,
    /// The number at the router that answers.
    pub number: u64,
    /// The identity.
    pub origin: Origin,
    /// The value; empty if it was forgotten.
    pub payload: Payload,
    /// The urgency of the message.
    pub urgency: Urgency,
    /// When it was published, in milliseconds since 1970 by the clock of its program.
    pub sent_ms: u64,
    /// How long ago it was published, or forgotten.
    pub age: Duration,
    /// Whether the program that published it has ended.
    pub has_ended: bool,
    /// Whether it was forgotten.
    pub is_forgotten: bool,
    /// Its position at the router of its robot; `None`: that is the router which answers.
    pub kept: Option<Position>,
}

impl Value {
    /// Returns the message of a value of that robot.
    pub fn message(&self, robot: Name) -> Message {
        let retained = Retained {
            age: self.age,
            has_ended: self.has_ended,
            is_forgotten: self.is_forgotten,
        };
        Message {
            urgency: self.urgency,
            sent_at: Sent::At(self.sent_ms).at(),
            value: match self.is_forgotten {
                true => Err(PayloadError::Forgotten),
                false => Ok(()),
            },
            retained: Some(retained),
            ..Message::new(robot, self.topic.clone(), self.payload.clone())
        }
    }
}

/// The fields of a value on the wire: robot and encoding are empty for the router's own and for JSON.
type Wire = (
    String,
    String,
    u64,
    Origin,
    u8,
    u64,
    u64,
    String,
    Bytes,
    Option<Position>,
);

impl From<Value> for Wire {
    fn from(value: Value) -> Self {
        let urgency = match value.urgency {
            Urgency::Normal => 0,
            Urgency::Urgent => IS_URGENT,
            Urgency::Bulk => IS_BULK,
        };
        let flag = |is_set, flag| if is_set { flag } else { 0 };
        let flags = flag(value.has_ended, HAS_ENDED) | flag(value.is_forgotten, IS_FORGOTTEN);
        let encoding = match value.payload.encoding == Encoding::JSON {
            true => String::new(),
            false => value.payload.encoding.as_str().to_owned(),
        };
        (
            value
                .robot
                .map_or_else(String::new, |robot| robot.to_string()),
            value.topic.to_string(),
            value.number,
            value.origin,
            flags | urgency,
            value.sent_ms,
            u64::try_from(value.age.as_millis()).unwrap_or(u64::MAX),
            encoding,
            value.payload.bytes,
            value.kept,
        )
    }
}

impl TryFrom<Wire> for Value {
    type Error = String;

    fn try_from(wire: Wire) -> Result<Self, String> {
        let (robot, topic, number, origin, flags, sent_ms, age_ms, encoding, bytes, kept) = wire;
        let robot = match robot.as_str() {
            "" => None,
            robot => Some(Name::new(robot).map_err(|error| error.to_string())?),
        };
        if bytes.len() > MAX_VALUE {
            return Err(format!("a value of {} bytes", bytes.len()));
        }
        let encoding = match encoding.as_str() {
            "" => Encoding::JSON,
            _ => Encoding::new(encoding),
        };
        encoding.check_length().map_err(|error| error.to_string())?;
        Ok(Self {
            robot,
            topic: Topic::new(&topic).map_err(|error| error.to_string())?,
            number,
            origin,
            payload: Payload::new(bytes, encoding),
            urgency: match flags & (IS_URGENT | IS_BULK) {
                IS_URGENT => Urgency::Urgent,
                IS_BULK => Urgency::Bulk,
                _ => Urgency::Normal,
            },
            sent_ms,
            age: Duration::from_millis(age_ms),
            has_ended: flags & HAS_ENDED != 0,
            is_forgotten: flags & IS_FORGOTTEN != 0,
            kept,
        })
    }
}

/// Writes a question, an order or an answer.
pub(super) fn write<T: Serialize>(document: &T) -> Payload {
    let mut bytes = Vec::new();
    // Writing to memory does not fail.
    let _ = ciborium::into_writer(document, &mut bytes);
    Payload::new(bytes, Encoding::CBOR)
}

/// Reads a question, an order or an answer.
///
/// # Errors
/// Returns the reason why the bytes are not one.
pub fn read<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    if bytes.len() > MAX_BYTES {
        return Err(format!(
            "{} bytes, and at most {MAX_BYTES} are allowed",
            bytes.len()
        ));
    }
    ciborium::from_reader(bytes).map_err(|error| error.to_string())
}

/// Returns the key expressions of a question, if all are valid and there are not too many.
pub(super) fn checked(keys: Vec<String>) -> Result<Vec<OwnedKeyExpr>, String> {
    if keys.len() > MAX_KEYS {
        return Err(format!(
            "{} topics, and at most {MAX_KEYS} are allowed",
            keys.len()
        ));
    }
    keys.into_iter()
        .map(|key| OwnedKeyExpr::autocanonize(key).map_err(|error| error.to_string()))
        .collect()
}

/// Returns whether a key is one of those.
pub(super) fn selects(keys: &[OwnedKeyExpr], key: &str) -> bool {
    keyexpr::new(key).is_ok_and(|key| keys.iter().any(|selected| selected.intersects(key)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value() -> Value {
        Value {
            robot: None,
            topic: Topic::new("mode").expect("valid topic"),
            number: 300,
            origin: Origin(7, 9),
            payload: Payload::new("\"auto\"", Encoding::JSON),
            urgency: Urgency::Urgent,
            sent_ms: 1_795_000_000_000,
            age: Duration::from_millis(1500),
            has_ended: true,
            is_forgotten: false,
            kept: None,
        }
    }

    #[test]
    fn pages_round_trip_in_few_bytes() {
        let page = Page {
            run: 0xABCD_EF01,
            at: 300,
            more: false,
            complete: vec![(String::new(), Position(1, 300))],
            records: vec![value(); 50],
        };
        let written = write(&page);
        assert!(written.bytes.len() < 50 * 45, "{}", written.bytes.len());
        assert_eq!(read::<Page>(&written.bytes), Ok(page));
    }

    #[test]
    fn values_that_no_router_has_are_refused() {
        let of = |change: fn(&mut Wire)| {
            let mut wire = Wire::from(value());
            change(&mut wire);
            Value::try_from(wire)
        };
        assert!(of(|_| {}).is_ok());
        assert!(of(|wire| wire.0 = "a b".to_owned()).is_err());
        assert!(of(|wire| wire.1 = "@rect/x".to_owned()).is_err());
        assert!(of(|wire| wire.7 = "x".repeat(300)).is_err());
        assert!(of(|wire| wire.8 = vec![0; MAX_VALUE + 1].into()).is_err());
        assert!(of(|wire| wire.8 = vec![0; MAX_VALUE].into()).is_ok());
    }
}
