//! Converts a recording for other programs: lines of JSON, or a table as CSV.
use std::io::{self, Write};

use rect_core::{codec::Limits, text::display};
use serde_json::{json, Value};

use crate::entry::{Entry, RetainedKind};

/// The form of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// An object for each message, on a line.
    JsonLines,
    /// A row for each number: time, topic, field and value.
    Csv,
}

/// The characters with which a formula may begin, also those of East Asian keyboards.
const FORMULA: [char; 8] = ['=', '+', '-', '@', '＝', '＋', '－', '＠'];
/// The first line of a CSV file.
const HEADER: &str = "time_s,topic,sequence,field,value";
/// How deeply nested values become rows of their own.
const MAX_DEPTH: usize = 8;

/// Writes entries in a format.
pub struct Exporter<W> {
    format: Format,
    to: W,
}

impl<W: Write> Exporter<W> {
    /// Begins an export.
    ///
    /// # Errors
    /// Fails if `to` does.
    pub fn new(format: Format, mut to: W) -> io::Result<Self> {
        if format == Format::Csv {
            writeln!(to, "{HEADER}")?;
        }
        Ok(Self { format, to })
    }

    /// Adds an entry.
    ///
    /// # Errors
    /// Fails if the output does.
    pub fn add(&mut self, entry: &Entry) -> io::Result<()> {
        match self.format {
            Format::JsonLines => {
                writeln!(self.to, "{}", display::json(&as_json(entry).to_string()))
            }
            Format::Csv => self.add_rows(entry, "", &value(entry), MAX_DEPTH),
        }
    }

    fn add_rows(
        &mut self,
        entry: &Entry,
        field: &str,
        value: &Value,
        depth: usize,
    ) -> io::Result<()> {
        let below = |name: &str| match field {
            "" => name.to_owned(),
            _ => format!("{field}.{name}"),
        };
        match value {
            Value::Object(fields) if depth > 0 => fields
                .iter()
                .try_for_each(|(name, value)| self.add_rows(entry, &below(name), value, depth - 1)),
            Value::Array(items) if depth > 0 => {
                items.iter().enumerate().try_for_each(|(n, value)| {
                    self.add_rows(entry, &below(&n.to_string()), value, depth - 1)
                })
            }
            _ => {
                let value = match value {
                    Value::String(text) => text.clone(),
                    value => value.to_string(),
                };
                writeln!(
                    self.to,
                    "{:.6},{},{},{},{}",
                    entry.logged.as_secs_f64(),
                    cell(&entry.topic),
                    entry.sequence,
                    cell(field),
                    cell(&value)
                )
            }
        }
    }

    /// Ends the export.
    ///
    /// # Errors
    /// Fails if the output does.
    pub fn finish(mut self) -> io::Result<()> {
        self.to.flush()
    }
}

fn as_json(entry: &Entry) -> Value {
    json!({
        "time_s": entry.logged.as_secs_f64(),
        "sent_s": entry.sent.as_secs_f64(),
        "topic": entry.topic,
        "recipient": entry.recipient,
        "retained": entry.retained.map(RetainedKind::name),
        "sequence": entry.sequence,
        "urgency": entry.urgency,
        "encoding": entry.payload.encoding.as_str(),
        "bytes": entry.payload.bytes.len(),
        "value": value(entry),
    })
}

/// Returns the value of a message as JSON. Bytes that have no value become null.
fn value(entry: &Entry) -> Value {
    entry
        .payload
        .to_json(&Limits::default())
        .unwrap_or_default()
}

/// Returns a cell of a CSV file (RFC 4180). A text that a spreadsheet may take for a formula is marked as text. A character that a
/// terminal would interpret becomes U+FFFD, except line breaks and tabs; JSON Lines have it as it is.
fn cell(text: &str) -> String {
    let is_formula = text.parse::<f64>().is_err()
        && (text.starts_with(['\t', '\r', '\n'])
            || text.trim_start().starts_with(FORMULA)
            || text
                .trim_start_matches(display::is_harmful)
                .starts_with(FORMULA));
    let shown = |c| match c {
        '\n' | '\t' => c,
        c if display::is_harmful(c) => char::REPLACEMENT_CHARACTER,
        c => c,
    };
    let plain = text.replace("\r\n", "\n").chars().map(shown).collect();
    let text: String = match is_formula {
        true => format!("'{plain}"),
        false => plain,
    };
    if text.contains([',', '"', '\n', '\r']) {
        return format!("\"{}\"", text.replace('"', "\"\""));
    }
    text
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, time::Duration};

    use super::*;
    use rect_core::{
        codec::array::Array,
        message::{
            encoding::Encoding,
            payload::{Cbor, Payload, ToPayload},
            urgency::Urgency,
        },
    };

    fn exported(format: Format, payload: Payload) -> String {
        let mut to = Vec::new();
        let mut exporter = Exporter::new(format, &mut to).expect("written");
        let entry = Entry {
            topic: "a/x".to_owned(),
            recipient: None,
            payload,
            urgency: Urgency::Normal,
            sequence: 7,
            publisher: Some(1),
            logged: Duration::from_millis(1500),
            sent: Duration::from_millis(1400),
            retained: None,
            foreign: None,
        };
        exporter.add(&entry).expect("written");
        exporter.finish().expect("written");
        String::from_utf8(to).expect("text")
    }

    #[test]
    fn csv_has_a_row_for_each_value() {
        let json = r#"{"volt": 11.9, "cells": [1, -2], "note": "a,\"b\"", "cmd": "=1+1"}"#;
        let csv = exported(Format::Csv, Payload::new(json, Encoding::JSON));
        let mut rows: Vec<_> = csv.lines().skip(1).collect();
        rows.sort_unstable();
        let expected = [
            "1.500000,a/x,7,cells.0,1",
            "1.500000,a/x,7,cells.1,-2",
            "1.500000,a/x,7,cmd,'=1+1",
            "1.500000,a/x,7,note,\"a,\"\"b\"\"\"",
            "1.500000,a/x,7,volt,11.9",
        ];
        assert_eq!(rows, expected);
        assert!(csv.starts_with(HEADER));
    }

    #[test]
    fn cells_that_may_be_formulas_are_marked() {
        for (text, expected) in [
            ("=1", "'=1"),
            (" =1", "' =1"),
            ("\t=1", "'\t=1"),
            ("\tx", "'\tx"),
            ("\rx", "'\u{fffd}x"),
            ("\nx", "\"'\nx\""),
            ("\u{a0}@x", "'\u{a0}@x"),
            ("\u{200b}=x", "'\u{fffd}=x"),
            ("＝1", "'＝1"),
            ("-1.5", "-1.5"),
            ("+1", "+1"),
            ("a=1", "a=1"),
            ("", ""),
        ] {
            assert_eq!(cell(text), expected, "{text:?}");
        }
    }

    #[test]
    fn exports_do_not_control_a_terminal() {
        let attack = "a\x1b]0;pwned\x07\u{202e}\u{200b}b\rc";
        let payload = Payload::new(attack, Encoding::TEXT);
        let line = exported(Format::JsonLines, payload.clone());
        let read: Value = serde_json::from_str(&line).expect("JSON");
        assert_eq!(read["value"], attack);
        for text in [line, exported(Format::Csv, payload)] {
            let harmful = |c: char| c != '\n' && display::is_harmful(c);
            assert!(!text.contains(harmful), "{text:?}");
        }
    }

    #[test]
    fn arrays_and_cbor_have_rows() {
        let rows = |payload| {
            let csv = exported(Format::Csv, payload);
            let rows = csv
                .lines()
                .skip(1)
                .map(|row| row.replace("1.500000,a/x,7,", ""));
            rows.collect::<Vec<_>>()
        };
        let array = Array::of(&[3], &[0.5f32, f32::NAN, f32::NEG_INFINITY]).expect("an array");
        let array = array.to_payload().expect("a payload");
        assert_eq!(rows(array.clone()), ["0,0.5", "1,NaN", "2,-Infinity"]);
        let numbers = BTreeMap::from([(1, 0.5), (2, f64::INFINITY)]);
        let cbor = Cbor(numbers).to_payload().expect("a payload");
        assert_eq!(rows(cbor.clone()), ["1,0.5", "2,Infinity"]);
        for (payload, expected) in [
            (array, json!([0.5, "NaN", "-Infinity"])),
            (cbor, json!({"1": 0.5, "2": "Infinity"})),
        ] {
            let line = exported(Format::JsonLines, payload);
            let read: Value = serde_json::from_str(&line).expect("JSON");
            assert_eq!(read["value"], expected);
        }
    }

    #[test]
    fn json_lines_have_the_value() {
        let line = exported(Format::JsonLines, Payload::new("hello", Encoding::TEXT));
        let read: Value = serde_json::from_str(&line).expect("JSON");
        assert_eq!(
            (&read["value"], &read["topic"]),
            (&json!("hello"), &json!("a/x"))
        );
        let bytes = exported(Format::JsonLines, Payload::new(vec![0xff], Encoding::BYTES));
        let read: Value = serde_json::from_str(&bytes).expect("JSON");
        assert_eq!((&read["value"], &read["bytes"]), (&Value::Null, &json!(1)));
    }
}
