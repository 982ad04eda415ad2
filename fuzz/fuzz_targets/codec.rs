//! Whatever a peer sends packed or as a picture: no decoder breaks, and none gives more than it may. The first byte picks
//! the format.
#![no_main]
use std::sync::{Arc, OnceLock};

use libfuzzer_sys::fuzz_target;
use rect::core::{
    codec::{decode, dictionary::Packed, quantised, Codec, Limits},
    dictionary::{Dictionaries, Dictionary},
    encoding::Encoding,
    payload::Payload,
};

const LIMITS: Limits = Limits {
    max_bytes: 1 << 20,
    max_pixels: 1 << 18,
};

fn known() -> &'static (Arc<Dictionary>, Dictionaries) {
    static KNOWN: OnceLock<(Arc<Dictionary>, Dictionaries)> = OnceLock::new();
    KNOWN.get_or_init(|| {
        let sample = |n: u32| format!(r#"{{"seq":{n},"angle_deg":{}}}"#, n * 7 % 360);
        let samples: Vec<String> = (0..1000).map(sample).collect();
        let dictionary = Arc::new(Dictionary::train(&samples, 1024).expect("trained"));
        (dictionary.clone(), Dictionaries::of(dictionary))
    })
}

fn unpack(bytes: &[u8], encoding: &'static str) {
    let payload = Payload::new(bytes.to_vec(), Encoding::new(encoding));
    if let Ok(undone) = decode(&payload, &LIMITS, &known().1) {
        assert!(undone.bytes.len() <= LIMITS.max_bytes);
    }
}

fn picture(bytes: &[u8], encoding: Encoding) {
    if let Ok(picture) = Payload::new(bytes.to_vec(), encoding).picture(&LIMITS) {
        assert!(picture.width() as usize * picture.height() as usize <= LIMITS.max_pixels);
        assert!(picture.pixels().len() <= LIMITS.max_bytes);
    }
}

/// What is packed with the dictionary comes back.
fn there_and_back(bytes: &[u8]) {
    let (dictionary, known) = known();
    let payload = Payload::new(bytes.to_vec(), Encoding::JSON);
    let packed = Packed::new(dictionary.clone()).encode(&payload);
    let packed = packed.expect("packed");
    assert_eq!(decode(&packed, &LIMITS, known), Ok(payload));
}

fuzz_target!(|data: &[u8]| {
    let Some((format, bytes)) = data.split_first() else {
        return;
    };
    match format % 8 {
        0 => unpack(bytes, "application/json;zstd"),
        1 => unpack(bytes, "application/json;zstd;zstd"),
        2 => picture(bytes, Encoding::PNG),
        3 => picture(bytes, Encoding::JPEG),
        4 => picture(bytes, Encoding::WEBP),
        5 => {
            let encoding = Encoding::new(quantised::ENCODING);
            if let Ok(array) = Payload::new(bytes.to_vec(), encoding).array(&LIMITS) {
                assert!(array.bytes().len() <= LIMITS.max_bytes);
            }
        }
        6 => there_and_back(bytes),
        _ => {
            if let Ok(dictionary) = Dictionary::new(bytes) {
                let again = Dictionary::new(dictionary.as_bytes()).expect("its own");
                assert_eq!(again.id(), dictionary.id());
                let payload = Payload::new("{\"seq\":1}".repeat(9), Encoding::JSON);
                let codec = Packed::new(Arc::new(dictionary));
                let packed = codec.encode(&payload).expect("packed");
                if packed != payload {
                    assert_eq!(codec.decode(&packed, &LIMITS), Ok(payload));
                }
            }
        }
    }
});
