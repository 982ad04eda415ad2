//! Defines the results of goals. One of at most [`MAX_VALUE`] is a part of the state of its goal. The program keeps the bytes of a larger
//! one ([`results`](super::results)), of which the state has a description. Clients request the bytes in pieces, as those of a transfer
//! ([`pull`](super::pull)).
use bytes::Bytes;
use ciborium::Value;
use serde::{Deserialize, Serialize};

use super::{to_value, MAX_RESULT, MAX_VALUE};
use crate::{
    message::{encoding::Encoding, payload::Payload},
    name::{topic::Topic, Name},
    text::{display::is_harmful, humanize},
    transfer::{offer::FileName, Checksum, Offer, TransferId},
};

/// The result of a handler.
#[derive(Clone, Debug, PartialEq)]
pub enum GoalResult {
    /// One that is part of a state.
    Value(Value),
    /// A larger one.
    Large(LargeResult, Bytes),
}

/// The description of a result that is not part of the state of its goal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LargeResult {
    /// The id of the transfer; see [`TransferId`].
    pub id: String,
    /// The size in bytes.
    pub size_bytes: u64,
    /// The checksum, in hexadecimal digits.
    pub sha256: String,
    /// The encoding.
    pub encoding: String,
}

impl GoalResult {
    /// Prepares the result of the goal `id` that `payload` is. Computes the checksum of a large one.
    ///
    /// # Errors
    /// Returns why it cannot be sent.
    pub fn new(id: &str, payload: Payload) -> Result<Self, String> {
        let size = payload.bytes.len();
        if size <= MAX_VALUE {
            return to_value(&payload).map(Self::Value);
        }
        if size > MAX_RESULT {
            return Err(format!(
                "it has {size} bytes, and at most {MAX_RESULT} are allowed: send it as a transfer, and its name here"
            ));
        }
        let payload = payload.sendable().map_err(|error| error.to_string())?;
        let checksum = Checksum::of(&payload.bytes);
        let described = LargeResult {
            id: TransferId::of(format!("{id} {checksum}").as_bytes()).to_string(),
            size_bytes: size as u64,
            sha256: checksum.to_string(),
            encoding: payload.encoding.as_str().to_owned(),
        };
        Ok(Self::Large(described, payload.bytes))
    }
}

impl LargeResult {
    /// Returns the transfer that the robot `sender` would offer for the result of the goal with this topic. The limit applies before
    /// anybody reserves memory.
    ///
    /// # Errors
    /// Returns why the result cannot be received, after "but".
    pub(super) fn offer(&self, sender: Name, topic: Topic) -> Result<(TransferId, Offer), String> {
        if self.size_bytes > MAX_RESULT as u64 {
            return Err(format!(
                "its result of {} cannot be received: at most {MAX_RESULT} bytes are allowed",
                humanize::bytes(self.size_bytes)
            ));
        }
        let encoding = Encoding::new(self.encoding.clone());
        let is_valid = encoding.check_length().is_ok() && !self.encoding.contains(is_harmful);
        let parts = (TransferId::parse(&self.id), Checksum::parse(&self.sha256));
        let (Some(id), Some(checksum), true) = (parts.0, parts.1, is_valid) else {
            return Err("the description of its result is not valid".to_owned());
        };
        let offer = Offer {
            sender,
            topic,
            name: FileName::default(),
            encoding,
            size_bytes: self.size_bytes,
            checksum,
            call: 0,
        };
        Ok((id, offer))
    }
}
