//! Defines a line of a log.
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{clean, level::Level};

/// The maximum length of a text, in bytes; longer ones are cut.
pub const MAX_TEXT: usize = 8 << 10;
/// The maximum length of the name of a logger, a field or a place in the source, in bytes.
const MAX_WORD: usize = 200;
/// The maximum number of fields.
const MAX_FIELDS: usize = 32;
/// The maximum length of a field, in bytes of its JSON.
const MAX_FIELD: usize = 1 << 10;
/// Counted for each line beside its text.
const OVERHEAD: usize = 64;

/// A line that a program has logged. Its text may have several lines, such as those of a stack trace.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// When it was logged, in milliseconds since 1970 by the clock of the robot.
    pub at: u64,
    /// How important it is.
    #[serde(default)]
    pub level: Level,
    /// The part of the program; `stdout` or `stderr` for its output.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub logger: String,
    /// The text.
    pub text: String,
    /// Values with names.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub fields: BTreeMap<String, Value>,
    /// The place in the source code, such as `arm.py:12`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub source: String,
}

impl Line {
    /// Creates a line without anything but its text.
    pub fn new(at_ms: u64, level: Level, text: impl Into<String>) -> Self {
        Self {
            at: at_ms,
            level,
            text: text.into(),
            ..Self::default()
        }
    }

    /// Returns the line within its limits, and without characters that must not be printed.
    #[must_use]
    pub fn clean(self) -> Self {
        let fields = self.fields.into_iter().take(MAX_FIELDS);
        Self {
            logger: clean::word(&self.logger, MAX_WORD),
            text: clean::text(&self.text, MAX_TEXT),
            source: clean::word(&self.source, MAX_WORD),
            fields: fields
                .map(|(name, value)| (clean::word(&name, MAX_WORD), field(value)))
                .collect(),
            ..self
        }
    }

    /// Returns about how much memory it takes, in bytes.
    pub fn size(&self) -> usize {
        let size = |value: &Value| match value {
            Value::String(text) => text.len(),
            _ => size_of::<Value>(),
        };
        let fields = self.fields.iter();
        let fields: usize = fields.map(|(name, value)| name.len() + size(value)).sum();
        OVERHEAD + self.logger.len() + self.text.len() + self.source.len() + fields
    }
}

/// Returns a number, a boolean or a text. Everything else becomes the text of its JSON.
fn field(value: Value) -> Value {
    match value {
        Value::String(text) => clean::text(&text, MAX_FIELD).into(),
        Value::Array(_) | Value::Object(_) => clean::text(&value.to_string(), MAX_FIELD).into(),
        other => other,
    }
}
