//! Tests the guarantees of all codecs, and their robustness against malformed input.
use proptest::prelude::*;

use super::*;
use crate::{
    codec::{
        dictionary::Dictionary,
        picture::{Format, Picture},
    },
    message::payload::PayloadError,
};

const LIMITS: Limits = Limits {
    max_bytes: 1 << 20,
    max_pixels: 100_000,
};

fn none() -> Dictionaries {
    Dictionaries::default()
}

fn telemetry(n: usize) -> String {
    let (angle, volts) = (12.0 + (n % 37) as f64 / 8.0, 11.9 - n as f64 / 4000.0);
    format!(
        r#"{{"robot":"wombat-{}","seq":{n},"angle_deg":{angle},"volts":{volts:.2}}}"#,
        n % 5
    )
}

fn dictionary() -> Arc<Dictionary> {
    let samples: Vec<String> = (0..2000).map(telemetry).collect();
    Arc::new(Dictionary::train(&samples, 4096).expect("trained"))
}

fn photograph(width: u32, height: u32, format: Format) -> Payload {
    let wave = |x: u32, y: u32, c: usize| {
        let (x, y) = (f64::from(x) / 17.0, f64::from(y) / 11.0);
        (127.0 + 60.0 * (x + c as f64).sin() + 60.0 * (y - x / 3.0).cos()) as u8
    };
    let rows = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let channels = format.channels();
    let pixels = rows.flat_map(|(x, y)| (0..channels).map(move |c| wave(x, y, c)));
    let pixels: Vec<u8> = pixels.collect();
    Picture::new(width, height, format, pixels)
        .expect("a picture")
        .payload()
}

fn codec(spec: &str) -> Arc<dyn Codec> {
    parse(spec).expect(spec)
}

fn largest_difference(a: &Payload, b: &Payload) -> u8 {
    let pairs = a.bytes.iter().zip(&b.bytes);
    pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}

/// MJPG of USB cameras has no Huffman tables; our encoder writes the standard ones.
#[test]
fn jpeg_without_huffman_tables_is_read_with_the_standard_ones() {
    for format in [Format::Grey8, Format::Rgb8] {
        let whole = codec("jpeg")
            .encode(&photograph(64, 48, format))
            .expect("encoded");
        let mut camera = whole.bytes[..2].to_vec();
        let mut at = 2;
        while whole.bytes[at + 1] != 0xda {
            let length = 2 + usize::from(u16::from_be_bytes([
                whole.bytes[at + 2],
                whole.bytes[at + 3],
            ]));
            if whole.bytes[at + 1] != 0xc4 {
                camera.extend_from_slice(&whole.bytes[at..at + length]);
            }
            at += length;
        }
        camera.extend_from_slice(&whole.bytes[at..]);
        assert!(camera.len() < whole.bytes.len());
        let camera = Payload::new(camera, Encoding::JPEG);
        assert_eq!(
            camera.picture(&LIMITS).expect("a picture"),
            whole.picture(&LIMITS).expect("a picture")
        );
        for cut in [1, 2, 3, 20, 100, camera.bytes.len() - 1] {
            let cut = Payload::new(camera.bytes.slice(..cut), Encoding::JPEG);
            assert!(cut.picture(&LIMITS).is_err());
        }
    }
}

#[test]
fn codec_names_round_trip() {
    for (spec, name) in [
        ("none", "none"),
        ("zstd", "zstd:3"),
        ("zstd:19", "zstd:19"),
        ("png", "png"),
        ("jpeg", "jpeg:80"),
        ("jpeg:1", "jpeg:1"),
        ("webp:100", "webp:100"),
        ("quantised:0.01", "quantised:0.01"),
        ("quantised:1e-3", "quantised:0.001"),
    ] {
        assert_eq!(codec(spec).name(), name);
        assert_eq!(codec(name).name(), name, "the full name");
    }
}

#[test]
fn invalid_specifications_are_rejected_with_the_valid_ones() {
    for (spec, part) in [
        ("", "zstd"),
        ("gzip", "jpeg"),
        ("ZSTD", "zstd[:1 to 19]"),
        ("none:1", "expected none"),
        ("png:9", "expected none"),
        ("zstd:0", "1 to 19"),
        ("zstd:20", "1 to 19"),
        ("zstd:", "1 to 19"),
        ("zstd:+3", "1 to 19"),
        ("jpeg:101", "1 to 100"),
        ("webp:fine", "1 to 100"),
        ("quantised", "largest error"),
        ("quantised:0", "largest error"),
        ("quantised:-1", "largest error"),
        ("quantised:NaN", "largest error"),
        ("quantised:inf", "largest error"),
    ] {
        let error = parse(spec).expect_err(spec).to_string();
        assert!(error.contains(part), "{spec}: {error}");
    }
    let long = parse(&"x".repeat(10_000)).expect_err("long").to_string();
    assert!(long.len() < 300, "quoted in full: {long}");
}

#[test]
fn pictures_round_trip_within_the_codecs_loss() {
    for format in [Format::Grey8, Format::Rgb8, Format::Rgba8] {
        let picture = photograph(61, 47, format);
        for (spec, off) in [("png", 0), ("jpeg:95", 30), ("webp:95", 40)] {
            let small = codec(spec).encode(&picture).expect(spec);
            assert!(small.encoding.as_str().starts_with("image/"));
            assert!(small.bytes.len() < picture.bytes.len(), "{spec}");
            let back = small.picture(&LIMITS).expect(spec);
            let same = codec(spec).decode(&small, &LIMITS).expect(spec);
            assert_eq!(same, back.clone().payload());
            assert_eq!((back.width(), back.height()), (61, 47));
            // JPEG has no transparency and WebP no grey, so the decoded picture may have other channels.
            if same.encoding == picture.encoding {
                assert!(
                    largest_difference(&same, &picture) <= off,
                    "{spec} {format:?}"
                );
            } else {
                assert_ne!(spec, "png");
            }
        }
    }
}

#[test]
fn codecs_of_pictures_and_arrays_reject_other_payloads() {
    let text = Payload::new("hello", Encoding::TEXT);
    for spec in ["png", "jpeg", "webp", "quantised:1"] {
        let error = codec(spec).encode(&text).expect_err(spec).to_string();
        assert!(error.contains("text/plain"), "{spec}: {error}");
    }
    let huge = Encoding::new("application/octet-stream;picture;rgb8;4294967295x4294967295");
    for spec in ["png", "jpeg", "webp"] {
        assert!(codec(spec)
            .encode(&Payload::new("x", huge.clone()))
            .is_err());
    }
    let wide = photograph(70_000, 1, Format::Grey8);
    for (spec, format) in [("jpeg", "JPEG"), ("webp", "WebP")] {
        let error = codec(spec).encode(&wide).expect_err(spec);
        assert!(matches!(&error, CodecError::TooLarge { format: f, .. } if *f == format));
    }
}

#[test]
fn decodes_compressed_payloads_of_any_encoding() {
    let json = Payload::new(telemetry(7).repeat(5), Encoding::JSON);
    let once = codec("zstd").encode(&json).expect("encoded");
    assert_eq!(once.encoding.as_str(), "application/json;zstd");
    assert!(once.bytes.len() < json.bytes.len() / 2);
    assert_eq!(codec("zstd").decode(&once, &LIMITS).expect("decoded"), json);
    assert_eq!(decode(&once, &LIMITS, &none()).expect("decoded"), json);
    for unknown in ["zenoh/bytes", "application/x-thing;v=1", "", ";", "zstd"] {
        let raw = Payload::new("\0\u{1}", Encoding::new(unknown));
        assert_eq!(decode(&raw, &LIMITS, &none()).expect("raw"), raw);
    }
}

#[test]
fn rejects_deeply_nested_frames() {
    let mut bytes = vec![7; 3000];
    let mut encoding = Encoding::BYTES;
    for depth in 1..=4 {
        bytes = zstd::compress(&bytes, 3, None).expect("encoded");
        encoding = encoding.with_suffix("zstd");
        let payload = Payload::new(bytes.clone(), encoding.clone());
        let decoded = decode(&payload, &LIMITS, &none());
        match depth {
            1 | 2 => assert_eq!(decoded.expect("decoded").bytes, vec![7; 3000]),
            _ => assert!(
                matches!(decoded, Err(CodecError::TooLarge { .. })),
                "{depth}"
            ),
        }
    }
}

#[test]
fn incompressible_payloads_are_unchanged() {
    for text in ["", "{}", "{\"a\":1}"] {
        let json = Payload::new(text, Encoding::JSON);
        assert_eq!(codec("zstd").encode(&json).expect("as it is"), json);
    }
    let long = Encoding::new("x".repeat(encoding_limit()));
    let payload = Payload::new(vec![0; 1000], long);
    assert_eq!(codec("zstd").encode(&payload).expect("as it is"), payload);
}

fn encoding_limit() -> usize {
    crate::message::encoding::MAX_BYTES
}

#[test]
fn frames_refer_to_the_dictionary_by_its_id() {
    let dictionary = dictionary();
    let encoded = dictionary_codec::DictionaryCodec::new(dictionary.clone());
    let json = Payload::new(telemetry(123_456), Encoding::JSON);
    let small = encoded.encode(&json).expect("encoded");
    assert_eq!(small.encoding.as_str(), "application/json;zstd");
    assert!(small.bytes.len() * 10 < json.bytes.len() * 6, "{small:?}");
    assert_eq!(encoded.decode(&small, &LIMITS).expect("decoded"), json);

    let id = dictionary.id();
    let here = Dictionaries::of(dictionary);
    assert_eq!(decode(&small, &LIMITS, &here).expect("decoded"), json);
    let error = decode(&small, &LIMITS, &none()).expect_err("not here");
    assert_eq!(error, CodecError::Dictionary { id });
    assert_eq!(codec("zstd").decode(&small, &LIMITS), Err(error));
    // The magic number is followed by a descriptor, two bytes of the id, and the length; there is no checksum.
    assert_eq!(small.bytes[4] & 0b111, 0b010);
    let [low, high] = [small.bytes[5], small.bytes[6]];
    assert_eq!(u32::from(u16::from_le_bytes([low, high])), id);
}

#[test]
fn truncated_and_damaged_frames_are_handled() {
    let dictionary = dictionary();
    let here = Dictionaries::of(dictionary.clone());
    let json = Payload::new(telemetry(99).repeat(3), Encoding::JSON);
    let with = dictionary_codec::DictionaryCodec::new(dictionary);
    for frame in [
        codec("zstd").encode(&json).expect("encoded"),
        with.encode(&json).expect("encoded"),
    ] {
        for cut in 0..frame.bytes.len() {
            let cut = Payload::new(frame.bytes.slice(..cut), frame.encoding.clone());
            let error = decode(&cut, &LIMITS, &here).expect_err("cut").to_string();
            assert!(error.contains("zstd"), "{error}");
        }
        let more = [&frame.bytes[..], &[0]].concat();
        let more = Payload::new(more, frame.encoding.clone());
        assert!(decode(&more, &LIMITS, &here).is_err(), "more");
        for n in 0..frame.bytes.len() {
            for flip in [1, 0x80, 0xff] {
                let mut wrong = frame.bytes.to_vec();
                wrong[n] ^= flip;
                let wrong = Payload::new(wrong, frame.encoding.clone());
                // Without a checksum, some changes go unnoticed. None may exceed the stated size or cause a panic.
                let _ = decode(&wrong, &LIMITS, &here);
            }
        }
    }
}

#[test]
fn decompression_bombs_are_rejected() {
    use std::io::Write;
    let mut sized = ::zstd::Encoder::new(Vec::new(), 3).expect("encoder");
    sized.set_pledged_src_size(Some(1 << 30)).expect("set");
    sized.include_contentsize(true).expect("set");
    let unsized_frame = ::zstd::Encoder::new(Vec::new(), 3).expect("encoder");
    for mut bomb in [sized, unsized_frame] {
        let zeros = vec![0; 1 << 20];
        for _ in 0..1 << 10 {
            bomb.write_all(&zeros).expect("written");
        }
        let bomb = bomb.finish().expect("written");
        assert!(bomb.len() < 200_000);
        let bomb = Payload::new(bomb, Encoding::JSON.with_suffix("zstd"));
        let error = decode(&bomb, &LIMITS, &none()).expect_err("a bomb");
        assert!(matches!(error, CodecError::TooLarge { .. }), "{error}");
        let error = decode(&bomb, &Limits::default(), &none()).expect_err("a bomb");
        assert!(matches!(error, CodecError::TooLarge { .. }), "{error}");
    }
}

#[test]
fn frames_without_a_content_size_are_decoded() {
    let text = telemetry(1).repeat(2000);
    let frame = ::zstd::stream::encode_all(text.as_bytes(), 3).expect("encoded");
    let frame = Payload::new(frame, Encoding::JSON.with_suffix("zstd"));
    let decoded = decode(&frame, &LIMITS, &none()).expect("decoded");
    assert_eq!(decoded.bytes, text.as_bytes());
    for cut in [0, 5, 9, 20, frame.bytes.len() - 1] {
        let cut = Payload::new(frame.bytes.slice(..cut), frame.encoding.clone());
        let error = decode(&cut, &LIMITS, &none()).expect_err("cut").to_string();
        assert!(error.contains("zstd"), "{error}");
    }
    let small = Limits {
        max_bytes: text.len() - 1,
        ..LIMITS
    };
    let error = decode(&frame, &small, &none()).expect_err("above the limit");
    assert!(matches!(error, CodecError::TooLarge { .. }), "{error}");
}

#[test]
fn frames_with_a_wrong_content_size_are_rejected() {
    // The magic number; a single segment with a length of one byte; the length; one raw block of two bytes, the last.
    let honest = [0x28, 0xB5, 0x2F, 0xFD, 0x20, 2, 0x11, 0, 0, b'h', b'i'];
    let read = |frame: &[u8]| {
        let payload = Payload::new(frame.to_vec(), Encoding::TEXT.with_suffix("zstd"));
        decode(&payload, &LIMITS, &none())
    };
    assert_eq!(read(&honest).expect("honest").bytes, "hi");
    for wrong in [0, 1, 3, 200] {
        let mut frame = honest;
        frame[5] = wrong;
        let error = read(&frame).expect_err("a wrong size");
        assert!(
            matches!(error, CodecError::Damaged { .. }),
            "{wrong}: {error}"
        );
    }
    // A length of eight bytes: 16 exabytes.
    let mut frame = honest[..4].to_vec();
    frame.extend([0xE0, 255, 255, 255, 255, 255, 255, 255, 127, 0x11, 0, 0]);
    frame.extend(*b"hi");
    let error = read(&frame).expect_err("a wrong size");
    assert!(matches!(error, CodecError::TooLarge { .. }), "{error}");
    // A skippable frame, and no frame.
    assert!(read(&[0x50, 0x2A, 0x4D, 0x18, 1, 0, 0, 0, 9]).is_err());
    assert!(read(&[]).is_err());
}

#[test]
fn truncated_pictures_are_errors_that_name_the_format() {
    let picture = photograph(24, 20, Format::Rgb8);
    for (spec, name) in [("png", "PNG"), ("jpeg", "JPEG"), ("webp", "WebP")] {
        let small = codec(spec).encode(&picture).expect(spec);
        let whole = small.picture(&LIMITS).expect("whole");
        for cut in 0..small.bytes.len() {
            let cut_off = Payload::new(small.bytes.slice(..cut), small.encoding.clone());
            match cut_off.picture(&LIMITS) {
                Err(error) => assert!(error.to_string().contains(name), "{cut}: {error}"),
                // Padding at the end is not needed.
                Ok(same) => {
                    assert!(cut + 2 >= small.bytes.len(), "{spec} cut to {cut}");
                    assert_eq!(same, whole, "{spec} cut to {cut}");
                }
            }
        }
    }
}

#[test]
fn damaged_pictures_stay_within_the_limits() {
    let picture = photograph(24, 20, Format::Rgba8);
    for spec in ["png", "jpeg", "webp"] {
        let small = codec(spec).encode(&picture).expect(spec);
        for n in 0..small.bytes.len() {
            for flip in [1, 0x10, 0xff] {
                let mut wrong = small.bytes.to_vec();
                wrong[n] ^= flip;
                let wrong = Payload::new(wrong, small.encoding.clone());
                if let Ok(picture) = wrong.picture(&LIMITS) {
                    let pixels = picture.width() * picture.height();
                    assert!(pixels as usize <= LIMITS.max_pixels);
                }
            }
        }
        for garbage in [&b""[..], b"\xff", b"{}", &[0; 64], &[0xff; 64]] {
            let garbage = Payload::new(garbage.to_vec(), small.encoding.clone());
            let error = garbage.picture(&LIMITS).expect_err("garbage");
            assert!(matches!(
                error,
                PayloadError::Codec(CodecError::Damaged { .. })
            ));
        }
    }
}

#[test]
fn pictures_with_huge_dimensions_are_rejected() {
    // Each is a valid picture whose header was changed.
    let mut png = codec("png")
        .encode(&photograph(2, 2, Format::Rgb8))
        .expect("png")
        .bytes
        .to_vec();
    png[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
    let crc = crc32fast::hash(&png[12..29]);
    png[29..33].copy_from_slice(&crc.to_be_bytes());
    let mut jpeg = codec("jpeg")
        .encode(&photograph(2, 2, Format::Rgb8))
        .expect("jpeg")
        .bytes
        .to_vec();
    let frame = jpeg.windows(2).position(|two| two == [0xff, 0xc0]);
    let frame = frame.expect("a frame header");
    jpeg[frame + 5..frame + 9].copy_from_slice(&[0xff; 4]);
    let mut webp = codec("webp")
        .encode(&photograph(2, 2, Format::Rgb8))
        .expect("webp")
        .bytes
        .to_vec();
    webp[26..30].copy_from_slice(&[0xff, 0x3f, 0xff, 0x3f]);
    for (bytes, encoding) in [
        (png, Encoding::PNG),
        (jpeg, Encoding::JPEG),
        (webp, Encoding::WEBP),
    ] {
        let huge = Payload::new(bytes, encoding);
        for limits in [LIMITS, Limits::default()] {
            let error = huge.picture(&limits).expect_err("huge");
            let is = matches!(error, PayloadError::Codec(CodecError::TooLarge { .. }));
            assert!(is, "{}: {error}", huge.encoding);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn compressed_bytes_round_trip(bytes in prop::collection::vec(0..4u8, 0..5000), level in 1..=19u8) {
        let payload = Payload::new(bytes, Encoding::CBOR);
        let encoded = zstd::Zstd::new(level).encode(&payload).expect("encoded");
        prop_assert!(encoded.bytes.len() <= payload.bytes.len());
        prop_assert_eq!(decode(&encoded, &LIMITS, &none()).expect("decoded"), payload);
    }

    #[test]
    fn png_keeps_every_pixel(
        width in 1..40u32, height in 1..40u32, kind in 0..3usize, seed in prop::collection::vec(any::<u8>(), 1..50)
    ) {
        let format = [Format::Grey8, Format::Rgb8, Format::Rgba8][kind];
        let size = (width * height) as usize * format.channels();
        let pixels: Vec<u8> = seed.iter().copied().cycle().take(size).collect();
        let picture = Picture::new(width, height, format, pixels).expect("a picture");
        let small = codec("png").encode(&picture.clone().payload()).expect("written");
        prop_assert_eq!(small.picture(&LIMITS).expect("read"), picture);
    }

    #[test]
    fn decoders_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        for encoding in ["image/png", "image/jpeg", "image/webp", quantised::ENCODING, "x;zstd", "x;zstd;zstd"] {
            let payload = Payload::new(bytes.clone(), Encoding::new(encoding));
            let _ = decode(&payload, &LIMITS, &none());
            let _ = payload.picture(&LIMITS);
            let _ = payload.array(&LIMITS);
        }
    }
}
