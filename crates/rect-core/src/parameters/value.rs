//! Defines the value of a parameter.
use std::fmt;

use serde::{Deserialize, Serialize};

/// The value of a parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a bool, number, text or list of numbers")]
pub enum Value {
    /// Yes or no.
    Bool(bool),
    /// An integer.
    Integer(i64),
    /// A finite number.
    Number(f64),
    /// A text, or the choice from a list.
    Text(String),
    /// A list of finite numbers.
    Numbers(Vec<f64>),
}

impl Value {
    /// Returns the name of its type, for messages.
    pub fn type_name(&self) -> &'static str {
        match self {
            Self::Bool(_) => "a bool",
            Self::Integer(_) => "an integer",
            Self::Number(_) => "a number",
            Self::Text(_) => "a text",
            Self::Numbers(_) => "a list of numbers",
        }
    }

    /// Returns its size in a message, in bytes, approximately.
    pub(super) fn size(&self) -> usize {
        match self {
            Self::Bool(_) => 1,
            Self::Integer(_) | Self::Number(_) => 9,
            Self::Text(text) => 3 + text.len(),
            Self::Numbers(numbers) => 3 + 9 * numbers.len(),
        }
    }
}

/// As in JSON; long texts and lists are cut.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const MAX_CHARACTERS: usize = 60;
        let text = match self {
            // JSON writes 2.0 as a float, which is longer to read than 2.
            Self::Number(number) => return write!(f, "{number}"),
            value => serde_json::to_string(value).unwrap_or_default(),
        };
        let cut: String = text.chars().take(MAX_CHARACTERS).collect();
        let end = if cut.len() < text.len() { "..." } else { "" };
        write!(f, "{cut}{end}")
    }
}

impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Self::Bool(value)
    }
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Self::Number(value)
    }
}

impl From<i64> for Value {
    fn from(value: i64) -> Self {
        Self::Integer(value)
    }
}

impl From<i32> for Value {
    fn from(value: i32) -> Self {
        Self::Integer(value.into())
    }
}

impl From<&str> for Value {
    fn from(value: &str) -> Self {
        Self::Text(value.to_owned())
    }
}

impl From<String> for Value {
    fn from(value: String) -> Self {
        Self::Text(value)
    }
}

impl From<Vec<f64>> for Value {
    fn from(value: Vec<f64>) -> Self {
        Self::Numbers(value)
    }
}
