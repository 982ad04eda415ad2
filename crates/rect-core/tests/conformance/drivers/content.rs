//! Describes payloads and attachments in the scenarios: `{"text": "..."}`, `{"hex": "..."}`, `{"zeros": <length>}`, and CBOR as
//! `{"cbor": ...}`, within which bytes have one of the other forms.
use bytes::Bytes;
use ciborium::Value as Cbor;
use rect_core::message::{encoding::Encoding, payload::Payload};
use serde_json::{json, Map, Value};

/// The length from which bytes that are all zero are described by it.
const LONG: usize = 1000;

/// Describes a payload according to its encoding.
pub fn of(payload: &Payload) -> Value {
    if payload.encoding == Encoding::CBOR {
        let document = ciborium::from_reader(&payload.bytes[..]).expect("CBOR");
        return json!({ "cbor": from_cbor(document) });
    }
    of_bytes(&payload.bytes)
}

/// Describes bytes as text if they are printable, and otherwise in hexadecimal.
pub fn of_bytes(bytes: &[u8]) -> Value {
    if bytes.len() > LONG && bytes.iter().all(|byte| *byte == 0) {
        return json!({ "zeros": bytes.len() });
    }
    match std::str::from_utf8(bytes) {
        Ok(text) if text.chars().all(|char| !char.is_control()) => json!({ "text": text }),
        _ => json!({ "hex": bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>() }),
    }
}

/// Returns the bytes that a scenario describes.
pub fn parse(value: &Value) -> Bytes {
    if let Some(document) = value.get("cbor") {
        let mut bytes = Vec::new();
        ciborium::into_writer(&to_cbor(document), &mut bytes).expect("written");
        return bytes.into();
    }
    let fields = value.as_object().unwrap_or_else(|| panic!("{value}"));
    plain(fields).unwrap_or_else(|| panic!("{value} does not describe bytes"))
}

fn plain(fields: &Map<String, Value>) -> Option<Bytes> {
    let (form, value) = fields.iter().next().filter(|_| fields.len() == 1)?;
    Some(match form.as_str() {
        "text" => Bytes::copy_from_slice(value.as_str()?.as_bytes()),
        "zeros" => vec![0; value.as_u64()? as usize].into(),
        "hex" => {
            let byte = |pair| u8::from_str_radix(std::str::from_utf8(pair).expect("hex"), 16);
            let pairs = value.as_str()?.as_bytes().chunks(2);
            pairs.map(|pair| byte(pair).expect("hex")).collect()
        }
        _ => return None,
    })
}

fn from_cbor(value: Cbor) -> Value {
    match value {
        Cbor::Bytes(bytes) => of_bytes(&bytes),
        Cbor::Array(values) => values.into_iter().map(from_cbor).collect(),
        Cbor::Map(fields) => {
            let key = |key: Cbor| key.into_text().expect("the name of a field");
            let fields = fields
                .into_iter()
                .map(|(name, value)| (key(name), from_cbor(value)));
            Value::Object(fields.collect())
        }
        value => serde_json::to_value(value).expect("a value of JSON"),
    }
}

fn to_cbor(value: &Value) -> Cbor {
    match value {
        Value::Object(fields) => match plain(fields) {
            Some(bytes) => Cbor::Bytes(bytes.to_vec()),
            None => {
                let fields = fields.iter();
                let field =
                    |(name, value): (&String, &Value)| (name.clone().into(), to_cbor(value));
                Cbor::Map(fields.map(field).collect())
            }
        },
        Value::Array(values) => Cbor::Array(values.iter().map(to_cbor).collect()),
        value => Cbor::serialized(value).expect("a value of CBOR"),
    }
}
