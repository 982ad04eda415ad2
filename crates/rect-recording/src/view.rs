//! Decides what a viewer is shown of a message: pictures as such, and everything else as a JSON object.
use rect_core::message::{encoding::Encoding, payload::Payload};
use serde_json::{json, Map, Value};

use crate::{
    entry::Entry,
    picture::{self, Kind},
    schema::Schema,
};

/// The field of a value that is not an object: viewers select values by the names of fields.
const VALUE: &str = "value";

/// The form in which a viewer is shown a message.
#[derive(Clone, Debug, PartialEq)]
pub enum View {
    /// A picture or a frame of a video, in the message of that kind.
    Picture(Kind, Vec<u8>),
    /// A JSON object.
    Object(Value),
}

impl View {
    /// Returns what is shown of a message.
    pub fn of(entry: &Entry) -> Self {
        let kind = Kind::of(&entry.payload.encoding);
        match kind.zip(picture::wrap(entry)) {
            Some((kind, message)) => Self::Picture(kind, message),
            None => Self::Object(object(&entry.payload)),
        }
    }

    /// Returns the viewers' name of the encoding.
    pub fn encoding(&self) -> &'static str {
        match self {
            Self::Picture(..) => picture::PROTOBUF,
            Self::Object(_) => "json",
        }
    }

    /// Returns a schema of messages like this one.
    pub fn schema(&self, topic: &str) -> Schema {
        match self {
            Self::Picture(kind, _) => Schema::of_picture(*kind),
            Self::Object(value) => Schema::of_value(topic, value),
        }
    }

    /// Returns the encoded message.
    pub fn into_bytes(self) -> Vec<u8> {
        match self {
            Self::Picture(_, message) => message,
            Self::Object(value) => value.to_string().into_bytes(),
        }
    }
}

/// Returns a value or a text as JSON; `None` if the payload is neither.
pub fn json_value(payload: &Payload) -> Option<Value> {
    let media_type = payload.encoding.media_type();
    if [Encoding::JSON.as_str(), Encoding::CBOR.as_str()].contains(&media_type) {
        return payload.value().ok();
    }
    payload.text().ok().map(Value::from)
}

/// Returns a payload as JSON. Bytes that are neither a value nor text are described.
pub fn value(payload: &Payload) -> Value {
    let description =
        || json!({"bytes": payload.bytes.len(), "encoding": payload.encoding.as_str()});
    json_value(payload).unwrap_or_else(description)
}

/// Returns a payload as an object.
pub fn object(payload: &Payload) -> Value {
    match value(payload) {
        Value::Object(fields) => Value::Object(fields),
        value => json!({ VALUE: value }),
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
    }
}
