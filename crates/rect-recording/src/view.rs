//! Decides what a viewer is shown of a message: pictures as such, and everything else as a JSON object. Files contain messages in
//! this form, and `rect foxglove` sends it.
use bytes::Bytes;
use rect_core::{
    codec::Limits,
    message::{
        encoding::{Encoding, EncodingKind},
        payload::Payload,
    },
};
use serde::de::IgnoredAny;
use serde_json::{json, Map, Value};

use crate::{
    entry::Entry,
    picture::{self, Kind},
};

/// The viewers' name of the encoding of objects.
pub const JSON: &str = "json";
/// The field of a value that is not an object: viewers select values by the names of fields.
const VALUE: &str = "value";
/// The largest array that is shown, in bytes: as JSON, it takes three times as much.
const MAX_ARRAY_BYTES: usize = 64 << 10;

/// The form in which a viewer is shown a message.
#[derive(Clone, Debug, PartialEq)]
pub enum View {
    /// A picture or a frame of a video, in the message of that kind.
    Picture(Kind, Bytes),
    /// The text of a JSON object.
    Object(Origin, Bytes),
}

/// How an object was made of a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// It is the payload.
    Payload,
    /// It contains the value of the payload.
    Value,
    /// It describes a payload that has no value.
    Description,
}

impl View {
    /// Returns what is shown of a message.
    pub fn of(entry: &Entry) -> Self {
        let payload = &entry.payload;
        let kind = Kind::of(&payload.encoding);
        if let Some((kind, message)) = kind.zip(picture::wrap(entry)) {
            return Self::Picture(kind, message.into());
        }
        if payload.encoding.kind() == EncodingKind::Json && is_object(&payload.bytes) {
            return Self::Object(Origin::Payload, payload.bytes.clone());
        }
        let (origin, value) = match known_value(payload) {
            Some(value) => (Origin::Value, wrapped(value)),
            None => (Origin::Description, description(payload)),
        };
        Self::Object(origin, value.to_string().into())
    }

    /// Returns the viewers' name of the encoding.
    pub fn encoding(&self) -> &'static str {
        match self {
            Self::Picture(..) => picture::PROTOBUF,
            Self::Object(..) => JSON,
        }
    }

    /// Returns the encoded message.
    pub fn message(&self) -> &Bytes {
        match self {
            Self::Picture(_, message) | Self::Object(_, message) => message,
        }
    }
}

/// Returns whether a text is a JSON object.
fn is_object(text: &[u8]) -> bool {
    text.trim_ascii_start().first() == Some(&b'{')
        && serde_json::from_slice::<IgnoredAny>(text).is_ok()
}

fn known_value(payload: &Payload) -> Option<Value> {
    let limits = Limits {
        max_bytes: MAX_ARRAY_BYTES,
        ..Limits::default()
    };
    payload.to_json(&limits)
}

fn description(payload: &Payload) -> Value {
    json!({"bytes": payload.bytes.len(), "encoding": payload.encoding.as_str()})
}

fn wrapped(value: Value) -> Value {
    match value {
        Value::Object(fields) => Value::Object(fields),
        value => json!({ VALUE: value }),
    }
}

/// Returns a payload as JSON. Bytes that have no value are described.
pub fn value(payload: &Payload) -> Value {
    known_value(payload).unwrap_or_else(|| description(payload))
}

/// Returns a payload as an object.
pub fn object(payload: &Payload) -> Value {
    wrapped(value(payload))
}

/// Returns the payload of that encoding for which a file has an object with [`Origin::Value`], and nothing else. Text comes back as
/// it was, and other values as JSON.
pub fn restored(encoding: &Encoding, text: &[u8]) -> Payload {
    let Ok(payload) = payload(text) else {
        return Payload::new(Bytes::copy_from_slice(text), encoding.clone());
    };
    match payload.value::<String>() {
        Ok(text) if encoding.kind() == EncodingKind::Text => Payload::new(text, encoding.clone()),
        _ => payload,
    }
}

/// Returns the payload that a viewer means with an object: the value itself where [`object`] would add a field.
///
/// # Errors
/// Fails if the text is not JSON.
pub fn payload(text: &[u8]) -> Result<Payload, serde_json::Error> {
    let value = match serde_json::from_slice(text)? {
        Value::Object(fields) => unwrapped(fields),
        value => value,
    };
    Ok(Payload::new(value.to_string(), Encoding::JSON))
}

fn unwrapped(mut fields: Map<String, Value>) -> Value {
    match fields.remove(VALUE) {
        Some(value) if fields.is_empty() && !value.is_object() => value,
        Some(value) => {
            fields.insert(VALUE.to_owned(), value);
            Value::Object(fields)
        }
        None => Value::Object(fields),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rect_core::{codec::array::Array, message::payload::ToPayload};

    #[test]
    fn values_become_objects_and_back() {
        for (value, shown) in [
            ("12.5", r#"{"value":12.5}"#),
            (r#""open""#, r#"{"value":"open"}"#),
            ("[1,2]", r#"{"value":[1,2]}"#),
            (r#"{"volt":11.9}"#, r#"{"volt":11.9}"#),
            (r#"{"value":1,"x":2}"#, r#"{"value":1,"x":2}"#),
            (r#"{"value":{"x":2}}"#, r#"{"value":{"x":2}}"#),
        ] {
            let sent = Payload::new(value, Encoding::JSON);
            let object = object(&sent).to_string();
            assert_eq!(object, shown);
            assert_eq!(payload(object.as_bytes()).expect("JSON"), sent);
            assert_eq!(restored(&Encoding::JSON, object.as_bytes()), sent);
        }
        assert!(payload(b"{").is_err());
    }

    #[test]
    fn other_payloads_are_shown_as_well() {
        let shown = |bytes: &'static [u8], encoding| object(&Payload::new(bytes, encoding));
        assert_eq!(shown(b"hello", Encoding::TEXT), json!({"value": "hello"}));
        assert_eq!(
            shown(b"\xff\x00", Encoding::BYTES),
            json!({"bytes": 2, "encoding": Encoding::BYTES.as_str()})
        );
        assert_eq!(
            shown(b"{not JSON", Encoding::JSON),
            json!({"bytes": 9, "encoding": Encoding::JSON.as_str()})
        );
        // The rest of a text, behind which another program has removed the payload.
        let text = restored(&Encoding::TEXT, br#"{"value":"hello"}"#);
        assert_eq!(text, Payload::new("hello", Encoding::TEXT));
        let numbers = restored(&Encoding::CBOR, br#"{"value":[1]}"#);
        assert_eq!(numbers, Payload::new("[1]", Encoding::JSON));
    }

    #[test]
    fn large_arrays_are_described() {
        let array = |count: usize| {
            let array = Array::of(&[count], &vec![1u8; count]).expect("an array");
            object(&array.to_payload().expect("a payload"))
        };
        let shown = array(MAX_ARRAY_BYTES);
        assert_eq!(
            shown["value"].as_array().map(Vec::len),
            Some(MAX_ARRAY_BYTES)
        );
        assert_eq!(array(MAX_ARRAY_BYTES + 1)["bytes"], MAX_ARRAY_BYTES + 1);
    }
}
