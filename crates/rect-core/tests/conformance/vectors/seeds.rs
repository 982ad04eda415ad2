//! Provides the inputs of the vectors, for rewriting them.
use std::sync::Arc;

use rect_core::{
    codec::{
        self,
        array::Array,
        dictionary::Dictionary,
        dictionary_codec::DictionaryCodec,
        picture::{Format, Picture},
        Codec,
    },
    message::{
        attachment::{Attachment, Sent},
        encoding::Encoding,
        payload::{Payload, ToPayload},
    },
};
use serde_json::{json, Value};

use super::hex;

fn texts<const N: usize>(texts: [&str; N]) -> Vec<Value> {
    texts.map(Value::from).into()
}

pub fn names() -> Vec<Value> {
    let mut names = texts([
        "a",
        "wombat-1",
        "Team.7_b",
        "hci",
        "hcix",
        "hci123456",
        "0",
        "-",
        "",
        "a b",
        "a/b",
        "*",
        "ä",
        ".",
        "..",
        "...",
        "hci0",
        "hci12345",
        "sim",
        "sim-a",
        "@rect",
        "a\n",
        "a$*",
    ]);
    names.extend([29, 30].map(|n| Value::from("x".repeat(n))));
    names
}

pub fn topics() -> Vec<Value> {
    let mut topics = texts([
        "a",
        "arm/angle",
        "arm/to/x",
        "a b",
        "ä/ö",
        "to-do",
        "",
        "/a",
        "a/",
        "a//b",
        "a/*",
        "**",
        "a$*",
        "to",
        "to/x",
        "@rect",
        "a/@x",
        "a#b",
        "a?b",
        "日本/角度",
        "a\u{200d}b",
        "a\nb",
        "a\tb",
        "a\u{1b}[2Jb",
        "a\u{7f}b",
        "a\u{9b}b",
        "a\u{200b}b",
        "a\u{200f}b",
        "a\u{202e}b",
        "a\u{2066}b",
        "a\u{feff}b",
        "a\u{e0041}b",
    ]);
    topics.extend([200, 201].map(|n| Value::from("x".repeat(n))));
    topics
}

pub fn patterns() -> Vec<Value> {
    texts([
        "wombat-2/arm/angle",
        "*/arm/*",
        "wombat-2/**",
        "*/**/**",
        "*/**/*",
        "a/b$*",
        "a/b$*$*",
        "a/$*$*$*/b",
        "",
        "arm",
        "**/arm",
        "w*/arm",
        "hci0/arm",
        "a/",
        "*/@rect/**",
        "*/to/x",
        "a//b",
        "*/ä/**",
        "*/a\nb/**",
        "*/a\u{1b}[2Jb/**",
        "*/a\u{202e}b/*",
        "a\u{202e}b/x",
    ])
}

pub fn keys() -> Vec<Value> {
    let here = |case: Value| {
        let mut all = json!({"fleet": "rect", "robot": "wombat-1"});
        if let (Some(all), Value::Object(case)) = (all.as_object_mut(), case) {
            all.extend(case);
        }
        all
    };
    let mut keys: Vec<Value> = vec![
        here(json!({"do": "publication", "topic": "arm/angle"})),
        here(json!({"do": "message", "recipient": "wombat-2", "topic": "arm/angle"})),
        here(json!({"do": "service", "of": "wombat-2", "topic": "plan"})),
        here(json!({"do": "service", "of": null, "topic": "plan"})),
        here(json!({"do": "own", "of": "wombat-2", "rest": "status"})),
        here(json!({"do": "own", "of": null, "rest": "status"})),
        here(json!({"do": "subscriptions", "pattern": "*/arm/*"})),
        here(json!({"do": "subscriptions", "pattern": "wombat-2/**"})),
    ];
    let read = [
        "rect/wombat-2/arm/angle",
        "rect/wombat-2/to/wombat-1/arm/angle",
        "rect/wombat-1/x",
        "rect/a/to/wombat-2/x",
        "rect/a/@rect/status",
        "rect/a/to",
        "rect/a/to/wombat-1",
        "rect/a/x/to/b",
        "lions/a/x",
        "rect/a",
        "rectx/a/x",
        "",
        "rect/a/x\u{1b}[2J",
        "rect/a/to/wombat-1/x\u{202e}",
    ];
    keys.extend(read.map(|key| here(json!({"do": "address", "key": key}))));
    keys
}

pub fn attachments() -> Vec<Value> {
    let good = [
        (0, 0, Sent::Unknown),
        (1, 127, Sent::Low(0)),
        (0xABCD, 128, Sent::At(1_795_000_000_000)),
        (65535, u32::MAX, Sent::At((1 << 48) - 1)),
        (7, 300, Sent::Low(65535)),
        (9, 1, Sent::Replayed(1_795_000_000_000)),
    ];
    let good = good.map(|(source, sequence, sent)| {
        let attachment = Attachment {
            source,
            sequence,
            sent,
            lifetime_ms: None,
        };
        hex(&attachment.encode())
    });
    let bad = [
        "",
        "f8",
        "f80000",
        "f8000080",
        "f800000000",
        "f900000000",
        "fa000000",
        "fb0000000000000000",
        "fc000000",
        "f80000ffffffff7f",
        "f80000ffffffffff01",
        "7b7d",
        "c3bf",
    ];
    good.into_iter()
        .chain(bad.map(String::from))
        .map(Value::from)
        .collect()
}

pub fn encodings() -> Vec<Value> {
    texts([
        "zenoh/bytes",
        "text/plain",
        "application/json",
        "application/json;zstd",
        "application/json;v=2;zstd",
        "application/json;zstd;zstd",
        "application/json;zstd;v=2",
        "application/jsonzstd",
        "application/json; charset=utf-8",
        "Application/JSON",
        "text/json",
        "application/geo+json",
        "application/json; charset=utf-16",
        "application/json-seq",
        "application/cbor;v=1",
        "application/senml+cbor",
        "zenoh/string",
        "zenoh/string;utf-8",
        "Text/Plain; Charset=\"UTF-8\"",
        "text/html;charset=iso-8859-1",
        "image/jpeg",
        "IMAGE/PNG; x=1",
        "image/webp",
        "video/h264",
        "application/octet-stream;picture;rgb8;640x480",
        "application/octet-stream;array;f32;480x640;zstd",
        ";zstd",
        "zstd",
        "",
    ])
}

pub fn codecs() -> Vec<Value> {
    texts([
        "none",
        "zstd",
        "zstd:1",
        "zstd:19",
        "png",
        "jpeg",
        "jpeg:100",
        "webp",
        "webp:1",
        "quantised:0.01",
        "quantised:1e-3",
        "",
        "gzip",
        "Zstd",
        "none:1",
        "png:9",
        "zstd:0",
        "zstd:20",
        "zstd:",
        "zstd:3.5",
        "jpeg:0",
        "jpeg:101",
        "quantised",
        "quantised:0",
        "quantised:-1",
        "quantised:nan",
    ])
}

fn message(n: usize) -> String {
    let angle = 12.0 + (n * 37 % 100) as f64 / 8.0;
    format!(r#"{{"robot":"wombat-1","seq":{n},"angle_deg":{angle},"ok":true}}"#)
}

fn dictionary() -> Dictionary {
    let samples: Vec<String> = (0..2000).map(message).collect();
    Dictionary::train(&samples, 1024).expect("trained")
}

pub fn dictionaries() -> Vec<Value> {
    let dictionary = dictionary();
    let mut renumbered = dictionary.as_bytes().to_vec();
    renumbered[4..8].copy_from_slice(&[1, 2, 3, 4]);
    let cut = &dictionary.as_bytes()[..60];
    let all = [dictionary.as_bytes(), &renumbered, cut, b"", b"{}"];
    all.map(|bytes| hex(bytes).into()).into()
}

fn case(payload: &Payload) -> Value {
    json!({"encoding": payload.encoding.as_str(), "bytes": hex(&payload.bytes)})
}

pub fn compressed() -> Vec<Value> {
    let dictionary = dictionary();
    let known = hex(dictionary.as_bytes());
    let with = DictionaryCodec::new(Arc::new(dictionary));
    let json = Payload::new(message(123_456), Encoding::JSON);
    let long = Payload::new(message(7).repeat(20), Encoding::JSON);
    let encode = |codec: &dyn Codec, payload: &Payload| codec.encode(payload).expect("encoded");
    let zstd = codec::parse("zstd").expect("a codec");
    let once = encode(&*zstd, &long);
    let mut twice = once.clone();
    twice.bytes = ::zstd::bulk::compress(&once.bytes, 3)
        .expect("encoded")
        .into();
    twice.encoding = once.encoding.with_suffix("zstd");
    let mut thrice = twice.clone();
    thrice.bytes = ::zstd::bulk::compress(&twice.bytes, 3)
        .expect("encoded")
        .into();
    thrice.encoding = twice.encoding.with_suffix("zstd");
    let small = encode(&with, &json);
    let mut with_known = case(&small);
    with_known["dictionary"] = known.into();
    let of = |bytes: Vec<u8>| Payload::new(bytes, Encoding::JSON.with_suffix("zstd"));
    let without_size = ::zstd::stream::encode_all(&long.bytes[..], 3).expect("encoded");
    let bomb = ::zstd::bulk::compress(&vec![0; 65_537], 3).expect("encoded");
    let bomb_without_size = ::zstd::stream::encode_all(&vec![0; 65_537][..], 3).expect("encoded");
    let mut cases = vec![
        case(&json),
        case(&Payload::new("x", Encoding::new("application/x-thing;v=1"))),
    ];
    cases.extend([&once, &twice, &thrice].map(case));
    cases.extend([with_known, case(&small)]);
    cases.extend([without_size, bomb, bomb_without_size].map(|bytes| case(&of(bytes))));
    let cut = once.bytes[..once.bytes.len() - 1].to_vec();
    let more = [&once.bytes[..], &[0]].concat();
    cases.extend([cut, more, vec![], b"{}".to_vec()].map(|bytes| case(&of(bytes))));
    cases
}

fn picture(format: Format) -> Payload {
    let size = 8 * 6 * format.channels();
    let pixels: Vec<u8> = (0..size).map(|n| 60 + (n * 3 % 130) as u8).collect();
    let picture = Picture::new(8, 6, format, pixels).expect("a picture");
    picture.to_payload().expect("written")
}

pub fn pictures() -> Vec<Value> {
    let mut cases = Vec::new();
    for format in [Format::Grey8, Format::Rgb8, Format::Rgba8] {
        let raw = picture(format);
        cases.push(case(&raw));
        for (spec, off) in [("png", 0), ("jpeg:90", 3), ("webp:90", 3)] {
            let small = codec::parse(spec)
                .expect("a codec")
                .encode(&raw)
                .expect(spec);
            let cut = Payload::new(
                small.bytes.slice(..small.bytes.len() / 2),
                small.encoding.clone(),
            );
            let mut whole = case(&small);
            whole["off"] = off.into();
            cases.extend([whole, case(&cut)]);
        }
    }
    let raw = |schema: &str, bytes: usize| {
        let encoding = Encoding::new(format!("application/octet-stream;{schema}"));
        case(&Payload::new(vec![0; bytes], encoding))
    };
    cases.extend([
        raw("picture;rgb8;2x2", 11),
        raw("picture;rgb8;0x0", 0),
        raw("picture;rgb9;2x2", 12),
        raw("picture;grey8;65x64", 4),
        raw("picture;rgba8;4000000000x4000000000", 4),
        raw("array;u8;4", 4),
        case(&Payload::new("{}", Encoding::JSON)),
    ]);
    cases
}

pub fn arrays() -> Vec<Value> {
    let raw = |schema: &str, bytes: usize| {
        let encoding = Encoding::new(format!("application/octet-stream;{schema}"));
        case(&Payload::new(vec![1; bytes], encoding))
    };
    let mut cases = vec![
        raw("array;u8;4", 4),
        raw("array;i8;2x2", 4),
        raw("array;u16;3", 6),
        raw("array;i16;3", 6),
        raw("array;u32;1", 4),
        raw("array;i32;1", 4),
        raw("array;i64;2", 16),
        raw("array;f32;1x1x1x1x1x1x1x2", 8),
        raw("array;f64;2", 16),
        raw("array;f32;0x3", 0),
        raw("array;f32;2", 4),
        raw("array;f16;1", 4),
        raw("array;u8;1x1x1x1x1x1x1x1x1", 1),
        raw("array;u8;65537", 4),
        raw("array;u8;0x4294967295", 0),
        raw("quantised", 9),
        raw("picture;rgb8;1x1", 3),
    ];
    let wave = |n: usize| (n as f64 / 20.0).sin() * 9.81;
    let mut odd: Vec<f64> = (0..30).map(wave).collect();
    odd[3] = f64::NAN;
    odd[9] = f64::NEG_INFINITY;
    odd[29] = 1e300;
    let smooth: Vec<f32> = (0..600).map(|n| wave(n) as f32).collect();
    let turns: Vec<f64> = (0..60)
        .map(|n| wave(n) + [0.0, 9.81, -40.0][n % 3])
        .collect();
    let noise: Vec<f32> = (0..8).map(|n| (n as f32 * 1e9).sin() * 1e30).collect();
    for array in [
        Array::of(&[5, 6], &odd),
        Array::of(&[600], &smooth),
        Array::of(&[20, 3], &turns),
        Array::of(&[8], &noise),
        Array::of(&[0], &[0f32; 0]),
        Array::of(&[1], &[2.5f64]),
    ] {
        let array = array.expect("an array").to_payload().expect("written");
        let small = codec::parse("quantised:0.01")
            .expect("a codec")
            .encode(&array);
        let small = small.expect("written");
        let cut = small.bytes.slice(..small.bytes.len() - 1);
        cases.extend([case(&small), case(&Payload::new(cut, small.encoding))]);
    }
    cases
}
