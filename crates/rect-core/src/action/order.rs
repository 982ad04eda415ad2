//! Defines the requests that start and cancel goals.
use ciborium::Value;
use serde::{Deserialize, Serialize};

use super::{cbor, null, MAX_VALUE};
use crate::{message::payload::Payload, name::parameter::is_name};

/// The maximum length of the name of a program that starts goals, in characters.
const MAX_BY: usize = 60;

/// A request to an action.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// Start a goal. One that is started already goes on.
    Start(Start),
    /// Cancel a goal.
    Cancel(Cancel),
}

/// The start of a goal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// The id of the goal, which the client chooses.
    pub id: String,
    /// The goal.
    #[serde(default = "null", skip_serializing_if = "Value::is_null")]
    pub goal: Value,
    /// The program that starts it; empty if it has no name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub by: String,
    /// How often feedback is sent at most, per second; `None`: as [`FEEDBACK_PER_S`](super::FEEDBACK_PER_S) says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedback_per_s: Option<f64>,
}

/// The cancel of a goal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cancel {
    /// The id of the goal.
    pub id: String,
    /// The program that cancels it; empty if it has no name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub by: String,
}

impl Order {
    /// Returns the order as bytes.
    pub fn write(&self) -> Payload {
        cbor(self)
    }

    /// Reads an order, in CBOR or JSON.
    ///
    /// # Errors
    /// Returns the reason.
    pub fn read(payload: &Payload) -> Result<Self, String> {
        if payload.bytes.len() > 2 * MAX_VALUE {
            let length = payload.bytes.len();
            return Err(format!("an order with {length} bytes is too long"));
        }
        let order: Self = payload.value().map_err(|error| {
            format!("this is not an order to an action (docs/reference/registry.md): {error}")
        })?;
        let (Self::Start(Start { id, by, .. }) | Self::Cancel(Cancel { id, by })) = &order;
        if !is_name(id) {
            return Err(
                "the id of a goal has 1 to 40 letters, digits, `_`, `-` and `.`".to_owned(),
            );
        }
        if by.chars().count() > MAX_BY {
            return Err(format!(
                "the name of a program has at most {MAX_BY} characters"
            ));
        }
        Ok(order)
    }
}
