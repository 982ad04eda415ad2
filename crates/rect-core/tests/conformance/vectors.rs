//! Checks the test vectors in `tests/conformance/*.json`, which every language must pass.
//!
//!     cargo test -p rect-core --test conformance
//!     RECT_UPDATE_VECTORS=1 cargo test -p rect-core --test conformance    # rewrites the vectors; review the diff
//!
//! Each file has `cases`, each with an input `in` and the expected output `out`, and an `about` that describes their
//! relation. Bytes are in hexadecimal.
use std::{path::PathBuf, sync::Arc};

use rect_core::{
    codec::{
        self,
        dictionary::{Dictionaries, Dictionary},
        CodecError, Limits,
    },
    message::{
        attachment::{Attachment, Sent},
        encoding::Encoding,
        payload::{Payload, PayloadError},
    },
    name::{
        key::KeySpace,
        topic::{Pattern, Topic},
        Name,
    },
};
use serde_json::{json, Value};

mod seeds;

/// The limits that all vectors assume.
const LIMITS: Limits = Limits {
    max_bytes: 65_536,
    max_pixels: 4096,
};

fn check(file: &str, about: &str, seeds: Vec<Value>, out: impl Fn(&Value) -> Value) {
    let path = PathBuf::from(crate::FOLDER);
    let path = path.join(file).with_extension("json");
    if std::env::var_os("RECT_UPDATE_VECTORS").is_some() {
        let case = |input: Value| {
            let out = out(&input);
            json!({"in": input, "out": out})
        };
        let cases: Vec<String> = seeds
            .into_iter()
            .map(case)
            .map(|case| format!("    {}", escaped(&case.to_string())))
            .collect();
        let (about, cases) = (json!(about), cases.join(",\n"));
        let text = format!("{{\n  \"about\": {about},\n  \"cases\": [\n{cases}\n  ]\n}}\n");
        std::fs::write(&path, text).expect("written");
    }
    let text = std::fs::read_to_string(&path).expect("the vectors");
    let vectors: Value = serde_json::from_str(&text).expect("JSON");
    let cases = vectors["cases"].as_array().expect("cases");
    assert!(!cases.is_empty());
    for case in cases {
        let (input, expected, found) = (&case["in"], &case["out"], out(&case["in"]));
        assert!(
            is_near(expected, &found),
            "{file}: {input}\n{expected}\n{found}"
        );
    }
}

/// Escapes the characters of a JSON text that an editor does not display.
fn escaped(json: &str) -> String {
    let is_shown = |c: char| !matches!(c, '\u{7f}'..='\u{9f}' | '\u{200b}'..='\u{206f}' | '\u{feff}' | '\u{e0000}'..='\u{e007f}');
    let mut text = String::with_capacity(json.len());
    for c in json.chars() {
        if is_shown(c) {
            text.push(c);
        } else {
            let mut units = [0; 2];
            text.extend(
                c.encode_utf16(&mut units)
                    .iter()
                    .map(|unit| format!("\\u{unit:04x}")),
            );
        }
    }
    text
}

/// Compares two values. Pixels may be off by `off`, because decoders of lossy pictures round differently.
fn is_near(expected: &Value, found: &Value) -> bool {
    let (Some(off), Some(pixels)) = (expected["off"].as_u64(), expected["pixels"].as_str()) else {
        return expected == found;
    };
    let found_pixels = bytes(&found["pixels"]);
    let expected_pixels = bytes(&pixels.into());
    let mut pairs = expected_pixels.iter().zip(&found_pixels);
    expected_pixels.len() == found_pixels.len()
        && ["width", "height", "format"].map(|key| &expected[key])
            == ["width", "height", "format"].map(|key| &found[key])
        && pairs.all(|(a, b)| u64::from(a.abs_diff(*b)) <= off)
}

fn text(value: &Value) -> &str {
    value.as_str().expect("text")
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bytes(hex: &Value) -> Vec<u8> {
    let pairs = text(hex).as_bytes().chunks(2);
    let pair = |pair| {
        std::str::from_utf8(pair)
            .ok()
            .and_then(|pair| u8::from_str_radix(pair, 16).ok())
    };
    pairs.map(|two| pair(two).expect("hex")).collect()
}

fn payload(input: &Value) -> Payload {
    let encoding = Encoding::new(text(&input["encoding"]).to_owned());
    Payload::new(bytes(&input["bytes"]), encoding)
}

fn kind(error: &CodecError) -> Value {
    match error {
        CodecError::Unknown { .. } => json!({"error": "unknown"}),
        CodecError::Option { .. } => json!({"error": "option"}),
        CodecError::Kind { .. } => json!({"error": "kind"}),
        CodecError::Damaged { .. } => json!({"error": "damaged"}),
        CodecError::TooLarge { .. } => json!({"error": "too large"}),
        CodecError::Dictionary { id } => json!({"error": "dictionary", "id": id}),
        CodecError::Failed { .. } => json!({"error": "failed"}),
    }
}

fn payload_kind(error: &PayloadError) -> Value {
    match error {
        PayloadError::Codec(error) => kind(error),
        PayloadError::Mismatch { .. } => json!({"error": "other"}),
        PayloadError::Read { .. } => json!({"error": "read"}),
        PayloadError::Write { .. } => json!({"error": "write"}),
        PayloadError::Type(_) => json!({"error": "type"}),
        PayloadError::Encoding(_) => json!({"error": "encoding"}),
        PayloadError::Forgotten => json!({"error": "forgotten"}),
    }
}

#[test]
fn names_are_validated() {
    let about = "Whether `in` is a valid name of a robot or a fleet.";
    check("names", about, seeds::names(), |input| {
        Name::new(text(input)).is_ok().into()
    });
}

#[test]
fn topics_are_validated() {
    let about = "Whether `in` is a valid topic of a message.";
    check("topics", about, seeds::topics(), |input| {
        Topic::new(text(input)).is_ok().into()
    });
}

#[test]
fn patterns_are_parsed() {
    let about = "The robot (null for any) and the topic of the pattern `in`, in canonical form; null if `in` is not a valid pattern.";
    check("patterns", about, seeds::patterns(), |input| {
        let Ok(pattern) = Pattern::new(text(input)) else {
            return Value::Null;
        };
        json!({"robot": pattern.robot().map(Name::as_str), "topic": pattern.topic()})
    });
}

#[test]
fn keys_are_built_and_parsed() {
    let about = "The keys of the robot `robot` of the fleet `fleet`. `do` selects the function: the key or keys of `publication`, \
        `message` (to `recipient`), `service` (of; null for all robots), `own` (of, rest) and `subscriptions` (pattern); or the \
        parts of an `address` (key), null if it is not the key of a message to this robot.";
    check("keys", about, seeds::keys(), |input| {
        let name = |value: &Value| {
            value
                .as_str()
                .map(|name| Name::new(name).expect("valid name"))
        };
        let named = |key: &str| name(&input[key]).expect("valid name");
        let keys = KeySpace {
            fleet: named("fleet"),
            robot: named("robot"),
        };
        let topic = || Topic::new(text(&input["topic"])).expect("valid topic");
        let of = name(&input["of"]);
        match text(&input["do"]) {
            "publication" => keys.publication(&topic()).into(),
            "message" => keys.message(&named("recipient"), &topic()).into(),
            "service" => keys.service(of.as_ref(), &topic()).into(),
            "own" => keys.own(of.as_ref(), text(&input["rest"])).into(),
            "subscriptions" => {
                let pattern = Pattern::new(text(&input["pattern"])).expect("valid pattern");
                json!(keys.subscriptions(&pattern).map(|selected| selected.key))
            }
            _ => keys
                .address(text(&input["key"]))
                .map_or(Value::Null, |address| {
                    let recipient = address.recipient.as_ref().map(Name::as_str);
                    json!({
                        "sender": address.sender.as_str(),
                        "recipient": recipient,
                        "topic": address.topic.as_str(),
                    })
                }),
        }
    });
}

#[test]
fn attachments_round_trip() {
    let about = "The content of the attachment `in`: `at_ms` since 1970, or the `low` 16 bits of that, or `recorded_ms` of the recorded message \
        that is replayed; null if it is not an attachment of RECT. Encoding the content yields the same bytes.";
    check("attachments", about, seeds::attachments(), |input| {
        let Some(attachment) = Attachment::decode(&bytes(input)) else {
            return Value::Null;
        };
        assert_eq!(hex(&attachment.encode()), text(input));
        let (at_ms, low, recorded_ms) = match attachment.sent {
            Sent::Unknown => (None, None, None),
            Sent::At(at_ms) => (Some(at_ms), None, None),
            Sent::Low(low) => (None, Some(low), None),
            Sent::Replayed(recorded_ms) => (None, None, Some(recorded_ms)),
        };
        let Attachment {
            source, sequence, ..
        } = attachment;
        json!({
            "source": source,
            "sequence": sequence,
            "at_ms": at_ms,
            "low": low,
            "recorded_ms": recorded_ms,
        })
    });
}

#[test]
fn encodings_are_split() {
    let about = "The parts of the encoding `in`; `below` is the encoding after decompression with zstd, null if it is not compressed; `kind` is what a payload with this encoding is.";
    check("encodings", about, seeds::encodings(), |input| {
        let encoding = Encoding::new(text(input).to_owned());
        let below = encoding.without_suffix("zstd");
        json!({
            "media_type": encoding.media_type(),
            "schema": encoding.schema(),
            "below": below.as_ref().map(Encoding::as_str),
            "kind": encoding.kind().as_str(),
        })
    });
}

#[test]
fn codecs_are_parsed() {
    let about = "The full name of the codec with the specification `in`, or the kind of error.";
    check("codecs", about, seeds::codecs(), |input| {
        codec::parse(text(input)).map_or_else(|error| kind(&error), |codec| codec.name().into())
    });
}

#[test]
fn dictionaries_have_their_id() {
    let about = "The id of the zstd dictionary `in`, 32768 + crc32(all after its first 8 bytes) % 32768; null if `in` is not a dictionary.";
    check("dictionaries", about, seeds::dictionaries(), |input| {
        Dictionary::new(bytes(input)).map_or(Value::Null, |dictionary| dictionary.id().into())
    });
}

#[test]
fn compressed_payloads_are_decoded() {
    let about = "The payload `in` after decompression with the `dictionary`, if there is one; or the kind of error. The limit is \
        65536 bytes.";
    check("compressed", about, seeds::compressed(), |input| {
        let dictionaries = match &input["dictionary"] {
            Value::Null => Dictionaries::default(),
            dictionary => Dictionaries::of(Arc::new(
                Dictionary::new(bytes(dictionary)).expect("a dictionary"),
            )),
        };
        match codec::decode(&payload(input), &LIMITS, &dictionaries) {
            Err(error) => kind(&error),
            Ok(decoded) => {
                json!({"encoding": decoded.encoding.as_str(), "bytes": hex(&decoded.bytes)})
            }
        }
    });
}

#[test]
fn pictures_are_decoded() {
    let about =
        "The picture in the payload `in`, whose pixels may be off by at most `off`; or the kind of error. The limits are \
        4096 pixels and 65536 bytes.";
    check(
        "pictures",
        about,
        seeds::pictures(),
        |input| match payload(input).picture(&LIMITS) {
            Err(error) => payload_kind(&error),
            Ok(picture) => json!({
                "width": picture.width(),
                "height": picture.height(),
                "format": picture.format().as_str(),
                "pixels": hex(picture.pixels()),
                "off": input["off"],
            }),
        },
    );
}

#[test]
fn arrays_are_decoded() {
    let about = "The array in the payload `in`, raw or quantised, with little-endian numbers; or the kind of error. The limit is \
        65536 bytes.";
    check("arrays", about, seeds::arrays(), |input| {
        match payload(input).array(&LIMITS) {
            Err(error) => payload_kind(&error),
            Ok(array) => json!({
                "element": array.element().as_str(),
                "shape": array.shape(),
                "bytes": hex(array.bytes()),
            }),
        }
    });
}
