//! Decodes untrusted compressed payloads and pictures. No decoder may panic or exceed its limits. The first byte of the
//! input selects the format.
use std::sync::{Arc, OnceLock};

use rect_core::{codec::{decode, dictionary_codec::DictionaryCodec, quantised, Codec, Limits, dictionary::{Dictionaries, Dictionary}}, message::{encoding::Encoding, payload::Payload}};

const LIMITS: Limits = Limits {
    max_bytes: 1 << 20,
    max_pixels: 1 << 18,
};

fn dictionaries() -> &'static (Arc<Dictionary>, Dictionaries) {
    static DICTIONARIES: OnceLock<(Arc<Dictionary>, Dictionaries)> = OnceLock::new();
    DICTIONARIES.get_or_init(|| {
        let sample = |n: u32| format!(r#"{{"seq":{n},"angle_deg":{}}}"#, n * 7 % 360);
        let samples: Vec<String> = (0..1000).map(sample).collect();
        let dictionary = Arc::new(Dictionary::train(&samples, 1024).expect("trains"));
        (dictionary.clone(), Dictionaries::of(dictionary))
    })
}

fn check_decode(bytes: &[u8], encoding: &'static str) {
    let payload = Payload::new(bytes.to_vec(), Encoding::new(encoding));
    if let Ok(decoded) = decode(&payload, &LIMITS, &dictionaries().1) {
        assert!(decoded.bytes.len() <= LIMITS.max_bytes);
    }
}

fn check_picture(bytes: &[u8], encoding: Encoding) {
    if let Ok(picture) = Payload::new(bytes.to_vec(), encoding).picture(&LIMITS) {
        assert!(picture.width() as usize * picture.height() as usize <= LIMITS.max_pixels);
        assert!(picture.pixels().len() <= LIMITS.max_bytes);
    }
}

/// Asserts that a payload that was encoded with the dictionary decodes to the same value.
fn check_round_trip(bytes: &[u8]) {
    let (dictionary, dictionaries) = dictionaries();
    let payload = Payload::new(bytes.to_vec(), Encoding::JSON);
    let encoded = DictionaryCodec::new(dictionary.clone()).encode(&payload);
    let encoded = encoded.expect("encodes");
    assert_eq!(decode(&encoded, &LIMITS, dictionaries), Ok(payload));
}

/// Runs the target on one input.
pub fn run(data: &[u8]) {
    let Some((format, bytes)) = data.split_first() else {
        return;
    };
    match format % 8 {
        0 => check_decode(bytes, "application/json;zstd"),
        1 => check_decode(bytes, "application/json;zstd;zstd"),
        2 => check_picture(bytes, Encoding::PNG),
        3 => check_picture(bytes, Encoding::JPEG),
        4 => check_picture(bytes, Encoding::WEBP),
        5 => {
            let encoding = Encoding::new(quantised::ENCODING);
            if let Ok(array) = Payload::new(bytes.to_vec(), encoding).array(&LIMITS) {
                assert!(array.bytes().len() <= LIMITS.max_bytes);
            }
        }
        6 => check_round_trip(bytes),
        _ => {
            if let Ok(dictionary) = Dictionary::new(bytes) {
                let again = Dictionary::new(dictionary.as_bytes()).expect("accepts its own bytes");
                assert_eq!(again.id(), dictionary.id());
                let payload = Payload::new("{\"seq\":1}".repeat(9), Encoding::JSON);
                let codec = DictionaryCodec::new(Arc::new(dictionary));
                let encoded = codec.encode(&payload).expect("encodes");
                if encoded != payload {
                    assert_eq!(codec.decode(&encoded, &LIMITS), Ok(payload));
                }
            }
        }
    }
}
