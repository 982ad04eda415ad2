//! Reads the fields of drivers and the arguments of calls.
use rect_core::{
    message::{encoding::Encoding, payload::Payload},
    name::{topic::Topic, Name},
};
use serde_json::Value;

use super::content;

pub fn text(value: &Value) -> &str {
    value
        .as_str()
        .unwrap_or_else(|| panic!("{value} is not a text"))
}

pub fn number(value: &Value) -> u64 {
    value
        .as_u64()
        .unwrap_or_else(|| panic!("{value} is not a number"))
}

pub fn name(text: &str) -> Name {
    Name::new(text).expect("a name")
}

pub fn topic(text: &str) -> Topic {
    Topic::new(text).expect("a topic")
}

/// Returns the run of a router or of a program.
pub fn run(driver: &Value) -> u32 {
    number(&driver["run"]) as u32
}

pub fn payload(payload: &Value, encoding: &Value) -> Payload {
    Payload::new(
        content::parse(payload),
        Encoding::new(text(encoding).to_owned()),
    )
}
