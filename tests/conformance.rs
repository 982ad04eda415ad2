//! What must be equal in every language, as vectors in `tests/conformance/*.json`: Rust's turn.
//!
//!     cargo test --no-default-features --test conformance
//!     RECT_UPDATE_VECTORS=1 cargo test --no-default-features --test conformance    # writes them anew; look at the diff
//!
//! Each file has `cases` of an `in` and an `out`, and says in `about` what makes the one of the other. Bytes are in hex.
use std::{path::PathBuf, sync::Arc};

use rect::core::{
    attachment::{Attachment, Sent},
    codec::{self, CodecError, Limits},
    dictionary::{Dictionaries, Dictionary},
    encoding::Encoding,
    key::Place,
    name::Name,
    payload::{Payload, PayloadError},
    topic::{Pattern, Topic},
};
use serde_json::{json, Value};

#[path = "conformance/seeds.rs"]
mod seeds;

/// Those of every file.
const LIMITS: Limits = Limits {
    max_bytes: 65_536,
    max_pixels: 4096,
};

fn check(file: &str, about: &str, seeds: Vec<Value>, out: impl Fn(&Value) -> Value) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/conformance");
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
        let (input, wanted, found) = (&case["in"], &case["out"], out(&case["in"]));
        assert!(
            is_near(wanted, &found),
            "{file}: {input}\n{wanted}\n{found}"
        );
    }
}

/// The same JSON without characters that an editor does not show as they are.
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

/// Equal; pixels may be off by `off`, since decoders of pictures with loss round differently.
fn is_near(wanted: &Value, found: &Value) -> bool {
    let (Some(off), Some(pixels)) = (wanted["off"].as_u64(), wanted["pixels"].as_str()) else {
        return wanted == found;
    };
    let found_pixels = bytes(&found["pixels"]);
    let wanted_pixels = bytes(&pixels.into());
    let mut pairs = wanted_pixels.iter().zip(&found_pixels);
    wanted_pixels.len() == found_pixels.len()
        && ["width", "height", "format"].map(|key| &wanted[key])
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
        PayloadError::Other { .. } => json!({"error": "other"}),
        PayloadError::Read { .. } => json!({"error": "read"}),
        PayloadError::Write { .. } => json!({"error": "write"}),
        PayloadError::Encoding(_) => json!({"error": "encoding"}),
    }
}

#[test]
fn names_are_told_from_what_is_none() {
    let about = "Whether `in` may be the name of a robot or a fleet.";
    check("names", about, seeds::names(), |input| {
        Name::new(text(input)).is_ok().into()
    });
}

#[test]
fn topics_are_told_from_what_is_none() {
    let about = "Whether `in` may be the topic of a message.";
    check("topics", about, seeds::topics(), |input| {
        Topic::new(text(input)).is_ok().into()
    });
}

#[test]
fn patterns_mean_the_same() {
    let about = "The robot (null: any) and the topic of the pattern `in`, in canonical form; null: it is none.";
    check("patterns", about, seeds::patterns(), |input| {
        let Ok(pattern) = Pattern::new(text(input)) else {
            return Value::Null;
        };
        json!({"robot": pattern.robot().map(Name::as_str), "topic": pattern.topic()})
    });
}

#[test]
fn keys_are_made_and_read_alike() {
    let about = "`do` for the place `fleet`, `robot`: the key or keys of `publication`, `message` (to), `service` (of; null: all), \
        `own` (of, rest) and `subscriptions` (pattern); what an `address` (key) says, null: nothing to this robot.";
    check("keys", about, seeds::keys(), |input| {
        let name = |value: &Value| value.as_str().map(|name| Name::new(name).expect("a name"));
        let named = |key: &str| name(&input[key]).expect("a name");
        let place = Place {
            fleet: named("fleet"),
            robot: named("robot"),
        };
        let topic = || Topic::new(text(&input["topic"])).expect("a topic");
        let of = name(&input["of"]);
        match text(&input["do"]) {
            "publication" => place.publication(&topic()).into(),
            "message" => place.message(&named("to"), &topic()).into(),
            "service" => place.service(of.as_ref(), &topic()).into(),
            "own" => place.own(of.as_ref(), text(&input["rest"])).into(),
            "subscriptions" => {
                let pattern = Pattern::new(text(&input["pattern"])).expect("a pattern");
                json!(place.subscriptions(&pattern))
            }
            _ => place.address(text(&input["key"])).map_or(Value::Null, |address| {
                let to = address.to.as_ref().map(Name::as_str);
                json!({"from": address.from.as_str(), "to": to, "topic": address.topic.as_str()})
            }),
        }
    });
}

#[test]
fn attachments_are_read_alike_and_written_back() {
    let about = "What the attachment `in` says; `at_ms` since 1970, or the `low` 16 bits of that; null: it is not RECT's. \
        What is read is written as it was.";
    check("attachments", about, seeds::attachments(), |input| {
        let Some(attachment) = Attachment::decode(&bytes(input)) else {
            return Value::Null;
        };
        assert_eq!(hex(&attachment.encode()), text(input));
        let (at_ms, low) = match attachment.sent {
            Sent::Unknown => (None, None),
            Sent::At(at_ms) => (Some(at_ms), None),
            Sent::Low(low) => (None, Some(low)),
        };
        let Attachment {
            source, sequence, ..
        } = attachment;
        json!({"source": source, "sequence": sequence, "at_ms": at_ms, "low": low})
    });
}

#[test]
fn encodings_have_the_same_parts() {
    let about = "The parts of the encoding `in`; `below`: the encoding of what is packed by zstd, null: it is not packed so.";
    check("encodings", about, seeds::encodings(), |input| {
        let encoding = Encoding::new(text(input).to_owned());
        let below = encoding.unpacked("zstd");
        json!({
            "media_type": encoding.media_type(),
            "schema": encoding.schema(),
            "below": below.as_ref().map(Encoding::as_str),
        })
    });
}

#[test]
fn codecs_have_the_same_names() {
    let about = "The whole name of the codec that the spec `in` means, or the kind of error.";
    check("codecs", about, seeds::codecs(), |input| {
        codec::parse(text(input)).map_or_else(|error| kind(&error), |codec| codec.name().into())
    });
}

#[test]
fn dictionaries_have_the_same_id() {
    let about = "The id of the zstd dictionary `in`, 32768 + crc32(all after its first 8 bytes) % 32768; null: it is none.";
    check("dictionaries", about, seeds::dictionaries(), |input| {
        Dictionary::new(bytes(input)).map_or(Value::Null, |dictionary| dictionary.id().into())
    });
}

#[test]
fn packings_are_undone_alike() {
    let about = "What the payload `in` is without its packings, where `dictionary`, if any, is known; or the kind of error. \
        At most 65536 bytes may come out.";
    check("packings", about, seeds::packings(), |input| {
        let known = match &input["dictionary"] {
            Value::Null => Dictionaries::default(),
            known => Dictionaries::of(Arc::new(
                Dictionary::new(bytes(known)).expect("a dictionary"),
            )),
        };
        match codec::decode(&payload(input), &LIMITS, &known) {
            Err(error) => kind(&error),
            Ok(undone) => {
                json!({"encoding": undone.encoding.as_str(), "bytes": hex(&undone.bytes)})
            }
        }
    });
}

#[test]
fn pictures_are_read_alike() {
    let about =
        "The picture in the payload `in`, its pixels off by at most `off`; or the kind of error. \
        It may have at most 4096 pixels and 65536 bytes.";
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
fn arrays_are_read_alike() {
    let about = "The array in the payload `in`, raw or quantised, its numbers little endian; or the kind of error. \
        It may have at most 65536 bytes.";
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
