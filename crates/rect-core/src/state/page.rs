//! The questions that programs and routers ask a router about state, and its answers, in CBOR.
use std::time::Duration;

use bytes::Bytes;
use serde::{de::DeserializeOwned, Deserialize, Serialize};
use zenoh_keyexpr::{keyexpr, OwnedKeyExpr};

use super::{Origin, Position, MAX_ROBOT, MAX_VALUE};
use crate::message::{
    attachment::Sent, encoding::Encoding, payload::Payload, retained::value::Value,
    urgency::Urgency,
};

/// The maximum number of key expressions in a question of another router.
pub const MAX_KEYS: usize = 256;
/// The maximum number of key expressions in a question of a program to its own router.
pub const MAX_KEYS_OF_PROGRAM: usize = 4096;
/// The size at which a page ends, in bytes. Its last value may exceed it.
pub(super) const PAGE: usize = 16 << 10;
/// The maximum size of a question or a page, in bytes.
const MAX_BYTES: usize = PAGE + MAX_VALUE + MAX_ROBOT;

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
    Set(NewValue),
    /// Forget a topic.
    Forget {
        /// The topic.
        topic: String,
        /// The identity of the change.
        origin: Origin,
        /// When it was forgotten.
        sent: Sent,
        /// How many milliseconds ago the program asked for that first.
        #[serde(default)]
        age_ms: u64,
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

impl Order {
    /// Returns the order as it is that long after a program has given it first.
    pub(super) fn after(&self, age: Duration) -> Self {
        let mut order = self.clone();
        if let Self::Set(NewValue { age_ms, .. }) | Self::Forget { age_ms, .. } = &mut order {
            *age_ms = u64::try_from(age.as_millis()).unwrap_or(u64::MAX);
        }
        order
    }
}

/// A value that a program gives to its router.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NewValue {
    /// The topic.
    pub topic: String,
    /// The identity of the value.
    pub origin: Origin,
    /// When it was published, by the clock of the program.
    pub sent: Sent,
    /// Its position at an earlier run of the router, if that had it. Then it is not published again.
    pub kept: Option<Position>,
    /// How many milliseconds ago it was published, or the program gave it to a router first.
    pub age_ms: u64,
    /// The urgency of the message.
    pub urgency: Urgency,
    /// Whether to keep it on disk.
    pub disk: bool,
    /// The encoding of the value.
    pub encoding: String,
    /// The value.
    pub bytes: Bytes,
}

/// The answer to [`Order::Set`] and [`Order::Forget`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Kept {
    /// The position of the value.
    pub at: Position,
    /// A problem that the program should know.
    pub warning: Option<String>,
    /// Whether another program has published the topic since, so that its value is the last one.
    #[serde(default)]
    pub is_replaced: bool,
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

/// Writes a question, an order or an answer.
pub(crate) fn write<T: Serialize>(document: &T) -> Payload {
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

/// Returns the key expressions of a question, if all are valid and there are at most `max`.
pub(super) fn checked(keys: Vec<String>, max: usize) -> Result<Vec<OwnedKeyExpr>, String> {
    if keys.len() > max {
        return Err(format!(
            "{} topics, and at most {max} are allowed",
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
    use crate::message::retained::value::tests::value;

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
}
