//! Measures size and time of small messages in each format for the bench `codecs`, and prints lines of JSON.
//!
//!     codecs KIND TRAINING_FILE MEASURED_FILE [KIND ...]     (files: one JSON message per line)
use std::{error::Error, hint::black_box, sync::Arc, time::Instant};

use rect_core::{
    codec::{self, dictionary::Dictionary, dictionary_codec::DictionaryCodec, Codec, Limits},
    message::{
        encoding::Encoding,
        payload::{Cbor, Json, Payload, ToPayload},
    },
};
use serde_json::{json, Value};

const ROUNDS: usize = 10;
const DICTIONARY_BYTES: usize = 16 << 10;

type Failure = Box<dyn Error>;

/// One format of the messages. The values are prepared, so that only encoding and decoding are timed.
trait MessageFormat {
    fn encode(&self, n: usize) -> Result<Vec<u8>, Failure>;
    fn decode(&self, bytes: &[u8]) -> Result<(), Failure>;
}

/// All formats with their names.
type MessageFormats = Vec<(String, Box<dyn MessageFormat>)>;

/// Converts from and to a tree of values.
struct Tree {
    values: Arc<Vec<Value>>,
    encode: fn(&Value) -> Result<Vec<u8>, Failure>,
    decode: fn(&[u8]) -> Result<Value, Failure>,
}

impl MessageFormat for Tree {
    fn encode(&self, n: usize) -> Result<Vec<u8>, Failure> {
        (self.encode)(&self.values[n])
    }

    fn decode(&self, bytes: &[u8]) -> Result<(), Failure> {
        black_box((self.decode)(bytes)?);
        Ok(())
    }
}

/// Converts from and to JSON text.
struct Text {
    payloads: Arc<Vec<Payload>>,
    codec: Arc<dyn Codec>,
}

impl MessageFormat for Text {
    fn encode(&self, n: usize) -> Result<Vec<u8>, Failure> {
        Ok(self.codec.encode(&self.payloads[n])?.bytes.into())
    }

    fn decode(&self, bytes: &[u8]) -> Result<(), Failure> {
        // A message that did not get smaller is unchanged JSON.
        let payload = Payload::new(bytes.to_vec(), Encoding::JSON.with_suffix("zstd"));
        if !bytes.starts_with(b"{") {
            black_box(self.codec.decode(&payload, &Limits::default())?);
        }
        Ok(())
    }
}

fn formats(train: &[&str], measure: &[&str]) -> Result<MessageFormats, Failure> {
    let values = measure.iter().map(|line| serde_json::from_str(line));
    let values: Arc<Vec<Value>> = Arc::new(values.collect::<Result<_, _>>()?);
    let text = |line: &&str| Payload::new(line.to_string(), Encoding::JSON);
    let payloads: Arc<Vec<Payload>> = Arc::new(measure.iter().map(text).collect());
    let mut formats = MessageFormats::new();
    let mut tree = |name: &str, encode, decode| {
        let values = values.clone();
        let format = Tree {
            values,
            encode,
            decode,
        };
        formats.push((name.to_owned(), Box::new(format)));
    };
    tree(
        "JSON",
        |value| Ok(Json(value).to_payload()?.bytes.into()),
        |bytes| Ok(serde_json::from_slice(bytes)?),
    );
    tree(
        "CBOR",
        |value| Ok(Cbor(value).to_payload()?.bytes.into()),
        |bytes| Ok(Payload::new(bytes.to_vec(), Encoding::CBOR).value()?),
    );
    tree(
        "MessagePack",
        |value| Ok(rmp_serde::to_vec(value)?),
        |bytes| Ok(rmp_serde::from_slice(bytes)?),
    );
    let dictionary = Arc::new(Dictionary::train(train, DICTIONARY_BYTES)?);
    let mut codecs = Vec::new();
    for level in [1, 3, 19] {
        codecs.push((
            format!("zstd {level}"),
            codec::parse(&format!("zstd:{level}"))?,
        ));
    }
    let with_dictionary: Arc<dyn Codec> = Arc::new(DictionaryCodec::new(dictionary));
    codecs.push(("zstd, dictionary".to_owned(), with_dictionary));
    for (name, codec) in codecs {
        let payloads = payloads.clone();
        formats.push((name, Box::new(Text { payloads, codec })));
    }
    Ok(formats)
}

struct Measured {
    bytes: usize,
    encode_us: f64,
    decode_us: f64,
}

fn measure(format: &dyn MessageFormat, messages: usize) -> Result<Measured, Failure> {
    let per_message = |start: Instant| start.elapsed().as_secs_f64() * 1e6 / messages as f64;
    let mut encoded = Vec::with_capacity(messages);
    let start = Instant::now();
    for n in 0..messages {
        encoded.push(format.encode(n)?);
    }
    let encode_us = per_message(start);
    let start = Instant::now();
    for bytes in &encoded {
        format.decode(bytes)?;
    }
    Ok(Measured {
        bytes: encoded.iter().map(Vec::len).sum(),
        encode_us,
        decode_us: per_message(start),
    })
}

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    for three in arguments.chunks_exact(3) {
        let (kind, train) = (&three[0], std::fs::read_to_string(&three[1])?);
        let lines = std::fs::read_to_string(&three[2])?;
        let (train, lines): (Vec<&str>, Vec<&str>) =
            (train.lines().collect(), lines.lines().collect());
        let formats = formats(&train, &lines)?;
        let json_bytes: usize = lines.iter().map(|line| line.len()).sum();
        let mut best: Vec<Option<Measured>> = formats.iter().map(|_| None).collect();
        for _ in 0..ROUNDS {
            for ((_, format), best) in formats.iter().zip(&mut best) {
                let mut now = measure(&**format, lines.len())?;
                if let Some(before) = best {
                    now.encode_us = now.encode_us.min(before.encode_us);
                    now.decode_us = now.decode_us.min(before.decode_us);
                }
                *best = Some(now);
            }
        }
        for ((format, _), best) in formats.iter().zip(best.into_iter().flatten()) {
            let bytes = best.bytes as f64 / lines.len() as f64;
            let ratio = best.bytes as f64 / json_bytes as f64;
            let (encode_us, decode_us) = (best.encode_us, best.decode_us);
            println!(
                "{}",
                json!({"kind": kind, "format": format, "bytes": bytes, "ratio": ratio,
                    "encode_us": encode_us, "decode_us": decode_us})
            );
        }
    }
    Ok(())
}
