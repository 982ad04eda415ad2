//! Describes in words why a value does not fit a type.
use serde::de::DeserializeOwned;
use serde_json::Value;
use serde_path_to_error::{Path, Segment};

/// How many characters of a text that does not fit are shown.
const MAX_SHOWN: usize = 60;

/// A value does not fit the type that the program has stated for it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}expected {expected}, found {found}", in_field(.field))]
pub struct Mismatch {
    /// The path to the part of the value that does not fit, such as `cells[2].volt`. Empty: the value itself.
    pub field: String,
    /// The values that the type allows, in words.
    pub expected: String,
    /// The value in their place, in words.
    pub found: String,
}

fn in_field(field: &str) -> String {
    if field.is_empty() {
        String::new()
    } else {
        format!("field {field}: ")
    }
}

/// Returns a value as a type.
pub(super) fn convert<T: DeserializeOwned>(value: &Value) -> Result<T, Mismatch> {
    serde_path_to_error::deserialize(value)
        .map_err(|error| mismatch(value, error.path(), &error.inner().to_string()))
}

/// Returns the mismatch that serde describes with a path and a text. The forms of the text are those of the provided
/// methods of `serde::de::Error`.
fn mismatch(value: &Value, path: &Path, text: &str) -> Mismatch {
    let mut field = path.to_string();
    if let Some(missing) = between(text, "missing field `", "`") {
        let dot = if path.iter().len() == 0 { "" } else { "." };
        return Mismatch {
            field: format!("{}{dot}{missing}", field.trim_start_matches('.')),
            expected: "a value".to_owned(),
            found: "no such field".to_owned(),
        };
    }
    if path.iter().len() == 0 {
        // serde_path_to_error writes a dot for the value itself.
        field.clear();
    }
    let expected = match text.rsplit_once(", expected ") {
        Some((_, expected)) => in_words(expected),
        None => format!("another value ({})", shortened(text)),
    };
    Mismatch {
        field,
        expected,
        found: part(value, path).map_or_else(|| "another value".to_owned(), described),
    }
}

fn between<'a>(text: &'a str, start: &str, end: &str) -> Option<&'a str> {
    text.strip_prefix(start)?.strip_suffix(end)
}

fn part<'a>(value: &'a Value, path: &Path) -> Option<&'a Value> {
    path.iter().try_fold(value, |value, segment| match segment {
        Segment::Seq { index } => value.get(index),
        Segment::Map { key } => value.get(key),
        // The variant of an enum that has fields is an object with one field.
        Segment::Enum { variant } => value.get(variant),
        Segment::Unknown => None,
    })
}

/// Returns the words for a type by those of serde.
fn in_words(expected: &str) -> String {
    let words = match expected {
        "a boolean" => "true or false",
        "a string" | "a borrowed string" => "text",
        "a character" => "text of one character",
        "a sequence" => "a list",
        "unit" => "nothing (null)",
        "f32" | "f64" => "a number",
        "i32" | "i64" | "i128" | "isize" => "an integer",
        "i8" => "an integer from -128 to 127",
        "i16" => "an integer from -32768 to 32767",
        "u8" => "an integer from 0 to 255",
        "u16" => "an integer from 0 to 65535",
        "u32" | "u64" | "u128" | "usize" => "an integer from 0",
        "a map" => "an object",
        "string or map" => "the name of a variant, or an object with it",
        _ if expected.starts_with("struct ") => "an object",
        _ => {
            return expected
                .replace('`', "'")
                .replacen("a tuple of size", "a list of", 1)
        }
    };
    words.to_owned()
}

/// Returns a value in words.
fn described(value: &Value) -> String {
    match value {
        Value::Null => "nothing (null)".to_owned(),
        Value::Bool(bool) => bool.to_string(),
        Value::Number(number) => format!("the number {number}"),
        Value::String(text) => format!("the text '{}'", shortened(text)),
        Value::Array(items) => format!("a list of {}", items.len()),
        Value::Object(fields) if fields.is_empty() => "an empty object".to_owned(),
        Value::Object(fields) => {
            // No more names than can be shown: an object may have a million of them.
            let names: Vec<_> = fields.keys().take(MAX_SHOWN).map(String::as_str).collect();
            format!("an object with the fields {}", shortened(&names.join(", ")))
        }
    }
}

fn shortened(text: &str) -> String {
    if text.chars().nth(MAX_SHOWN).is_none() {
        return text.to_owned();
    }
    text.chars().take(MAX_SHOWN - 1).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use serde::Deserialize;
    use serde_json::json;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[allow(dead_code, reason = "only the conversion is tested")]
    struct Battery {
        percent: f64,
        cells: Vec<Cell>,
        #[serde(default)]
        note: Option<String>,
        state: State,
    }

    #[derive(Debug, Deserialize)]
    #[allow(dead_code, reason = "only the conversion is tested")]
    struct Cell {
        volt: (u8, f32),
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "lowercase")]
    #[allow(dead_code, reason = "only the conversion is tested")]
    enum State {
        Full,
        Charging { amps: f32 },
    }

    fn text<T: DeserializeOwned + Debug>(value: &Value) -> String {
        convert::<T>(value)
            .expect_err("it does not fit")
            .to_string()
    }

    fn battery(change: impl FnOnce(&mut Value)) -> Value {
        let mut value = json!({"percent": 80, "cells": [{"volt": [3, 0.5]}], "state": "full"});
        convert::<Battery>(&value).expect("it fits");
        change(&mut value);
        value
    }

    #[test]
    fn the_part_that_does_not_fit_is_named() {
        let of = |change: fn(&mut Value)| text::<Battery>(&battery(change));
        let cases = [
            (
                of(|value| value["percent"] = json!("full")),
                "field percent: expected a number, found the text 'full'",
            ),
            (
                of(|value| value["cells"][0]["volt"][0] = json!(300)),
                "field cells[0].volt[0]: expected an integer from 0 to 255, found the number 300",
            ),
            (
                of(|value| value["cells"][0]["volt"] = json!([1])),
                "field cells[0].volt: expected a list of 2, found a list of 1",
            ),
            (
                of(|value| value["cells"][0] = json!({})),
                "field cells[0].volt: expected a value, found no such field",
            ),
            (
                of(|value| value["note"] = json!(3)),
                "field note: expected text, found the number 3",
            ),
            (
                of(|value| value["state"] = json!("empty")),
                "field state: expected 'full' or 'charging', found the text 'empty'",
            ),
            (
                of(|value| value["state"] = json!({"charging": {"amps": null}})),
                "field state.charging.amps: expected a number, found nothing (null)",
            ),
            (
                of(|value| *value = json!(12.5)),
                "expected an object, found the number 12.5",
            ),
            (
                of(|value| *value = json!({})),
                "field percent: expected a value, found no such field",
            ),
        ];
        for (found, expected) in cases {
            assert_eq!(found, expected);
        }
    }

    #[test]
    fn large_values_are_shown_in_part() {
        let long = text::<bool>(&json!("x".repeat(1_000_000)));
        assert!(long.chars().count() < 120, "{long}");
        let wide = (0..100_000).map(|n| (n.to_string(), Value::Null)).collect();
        let wide = text::<bool>(&Value::Object(wide));
        assert!(wide.chars().count() < 150, "{wide}");
    }
}
