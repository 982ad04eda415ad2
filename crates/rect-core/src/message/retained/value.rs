//! A value of a retained topic, as routers and programs exchange it.
use std::time::Duration;

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use super::{Origin, Position, Retained, MAX_VALUE};
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

const HAS_ENDED: u8 = 1;
const IS_FORGOTTEN: u8 = 2;
const IS_URGENT: u8 = 4;
const IS_BULK: u8 = 8;
const IS_REPLAYED: u8 = 16;

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
    /// When it was published, by the clock of its program.
    pub sent: Sent,
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
            sent_at: self.sent.at(),
            replayed: self.sent.is_replayed(),
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
        let flags = flag(value.has_ended, HAS_ENDED)
            | flag(value.is_forgotten, IS_FORGOTTEN)
            | flag(value.sent.is_replayed(), IS_REPLAYED);
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
            value.sent.ms().unwrap_or(0),
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
            sent: match flags & IS_REPLAYED {
                0 => Sent::At(sent_ms),
                _ => Sent::Replayed(sent_ms),
            },
            age: Duration::from_millis(age_ms),
            has_ended: flags & HAS_ENDED != 0,
            is_forgotten: flags & IS_FORGOTTEN != 0,
            kept,
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn value() -> Value {
        Value {
            robot: None,
            topic: Topic::new("mode").expect("valid topic"),
            number: 300,
            origin: Origin(7, 9),
            payload: Payload::new("\"auto\"", Encoding::JSON),
            urgency: Urgency::Urgent,
            sent: Sent::Replayed(1_795_000_000_000),
            age: Duration::from_millis(1500),
            has_ended: true,
            is_forgotten: false,
            kept: None,
        }
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
