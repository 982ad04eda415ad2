//! Defines the request that changes parameters, its replies, and the message with the values.
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{Value, MAX_BYTES};
use crate::{
    message::{
        encoding::Encoding,
        payload::{Payload, ToPayload},
    },
    text::display::is_harmful,
};

/// The maximum length of the name of a program that changes parameters, in characters.
const MAX_BY: usize = 60;

/// Changes some parameters of a group, all or none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Order {
    /// The new values.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub set: BTreeMap<String, Value>,
    /// The parameters that get their defaults.
    #[serde(default, skip_serializing_if = "Reset::is_none")]
    pub reset: Reset,
    /// Whether a second reply shall say when the values are stored.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stored: bool,
    /// The program that changes them.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub by: String,
}

/// The parameters that get their defaults.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "`reset` is a list of names, or true for all")]
pub enum Reset {
    /// All, or none.
    All(bool),
    /// Some.
    Some(Vec<String>),
}

impl Default for Reset {
    fn default() -> Self {
        Self::All(false)
    }
}

impl Reset {
    fn is_none(&self) -> bool {
        *self == Self::All(false)
    }
}

/// The reply to an order that was carried out: the values that are in force now of the parameters that it names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InForce {
    /// The values.
    pub values: BTreeMap<String, Value>,
}

/// The second reply, if the order asks for it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stored {
    /// Whether the values are in the file.
    pub stored: bool,
    /// Why they are not.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

/// The message with the values of a group, which is retained.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// All values.
    pub values: BTreeMap<String, Value>,
    /// The parameters that the last change has changed; empty when the program has just started.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub changed: Vec<String>,
    /// The program that made the last change, `<robot>/<program>`; empty if it was the program itself.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub by: String,
}

impl Order {
    /// Creates the order to change values.
    pub fn set<K: Into<String>, V: Into<Value>>(values: impl IntoIterator<Item = (K, V)>) -> Self {
        let set = values
            .into_iter()
            .map(|(name, value)| (name.into(), value.into()));
        Self {
            set: set.collect(),
            ..Self::default()
        }
    }

    /// Reads an order in CBOR or JSON.
    ///
    /// # Errors
    /// Returns why it is not one.
    pub fn read(payload: &Payload) -> Result<Self, String> {
        if payload.bytes.len() > 2 * MAX_BYTES {
            return Err(format!(
                "{} bytes, and at most {} are allowed",
                payload.bytes.len(),
                2 * MAX_BYTES
            ));
        }
        // A stock program may leave out the encoding.
        let payload = match payload.encoding == Encoding::BYTES {
            true => Payload::new(payload.bytes.clone(), Encoding::JSON),
            false => payload.clone(),
        };
        let order: Self = payload.value().map_err(|error| {
            format!(r#"the request must be like {{"set": {{"kp": 2.0}}}}: {error}"#)
        })?;
        let by = order.by.chars().filter(|c| !is_harmful(*c)).take(MAX_BY);
        Ok(Self {
            by: by.collect(),
            ..order
        })
    }
}

/// Returns a document of this module as CBOR.
pub fn to_cbor(document: &impl Serialize) -> Payload {
    // Names, texts and numbers can always be serialized.
    let payload = crate::message::payload::Cbor(document).to_payload();
    payload.unwrap_or_else(|_| Payload::new("", Encoding::CBOR))
}
