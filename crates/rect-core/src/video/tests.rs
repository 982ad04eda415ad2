//! Tests the encoder and the decoder with each other.
use std::time::{Duration, Instant};

use bytes::Bytes;

use super::{bitstream::is_key_frame, pending::Pending, *};
use crate::codec::{
    picture::{Format, Picture},
    Limits,
};

const SETTINGS: Settings = Settings {
    bytes_per_s: 28_000.0,
    frames_per_s: 15.0,
    quarters: 4,
    is_key: false,
};

/// A smooth scene that moves to the left.
fn scene(width: u32, height: u32, format: Format, frame: u32) -> Picture {
    let value = |x: u32, y: u32, channel: u32| {
        let (x, y) = ((x + frame * 2) as f32, y as f32);
        let wave = (x / 17.0).sin() + (y / 11.0 + channel as f32).cos();
        (127.5 + wave * 60.0) as u8
    };
    let channels = format.channels() as u32;
    let pixels: Vec<u8> = (0..width * height * channels)
        .map(|n| (n / channels, n % channels))
        .map(|(pixel, channel)| value(pixel % width, pixel / width, channel))
        .collect();
    Picture::new(width, height, format, pixels).expect("a picture")
}

/// Encodes 15 pictures per second, and returns the frames.
fn encoded(size: (u32, u32), format: Format, frames: u32) -> Vec<Bytes> {
    let (mut encoder, start) = (Encoder::default(), Instant::now());
    let encode = |n: u32| {
        let picture = scene(size.0, size.1, format, n);
        let now = start + Duration::from_secs(1) * n / 15;
        let payload = encoder.encode(&picture, SETTINGS, now).expect("encoded");
        payload.bytes
    };
    (0..frames).map(encode).collect()
}

/// Returns the mean difference of the values of two pictures.
fn difference(one: &Picture, other: &Picture) -> f64 {
    assert_eq!((one.width(), one.height()), (other.width(), other.height()));
    let pairs = one.pixels().iter().zip(other.pixels());
    let sum: f64 = pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    sum / one.pixels().len() as f64
}

#[test]
fn pictures_survive_and_cost_little() {
    let frames = encoded((320, 240), Format::Rgb8, 45);
    let limits = Limits::default();
    let mut decoder = Decoder::default();
    for (n, frame) in (0..).zip(&frames) {
        assert_eq!(is_key_frame(frame), n == 0, "frame {n}");
        let picture = decoder
            .decode(frame, &limits)
            .expect("valid")
            .expect("a picture");
        let difference = difference(&scene(320, 240, Format::Rgb8, n), &picture);
        assert!(difference < 6.0, "frame {n}: {difference}");
    }
    let bytes: usize = frames[15..].iter().map(Bytes::len).sum();
    assert!(bytes < 2 * 28_000, "{bytes} bytes in two seconds");
}

#[test]
fn odd_sizes_and_all_formats_are_encoded() {
    for (size, format, expected) in [
        ((161, 121), Format::Grey8, (160, 120)),
        ((161, 121), Format::Rgb8, (160, 120)),
        ((160, 121), Format::Rgba8, (160, 120)),
        ((16, 16), Format::Rgb8, (16, 16)),
        ((17, 500), Format::Rgb8, (16, 500)),
    ] {
        let frames = encoded(size, format, 3);
        let mut decoder = Decoder::default();
        for frame in &frames {
            let decoded = decoder.decode(frame, &Limits::default());
            let picture = decoded.expect("valid").expect("a picture");
            assert_eq!(
                (picture.width(), picture.height()),
                expected,
                "{size:?} {format:?}"
            );
        }
    }
    let tiny = scene(8, 8, Format::Rgb8, 0);
    assert!(!fits(8, 8) && !fits(3841, 100) && fits(2160, 3840));
    let huge = Picture::new(4000, 16, Format::Grey8, vec![0; 64_000]).expect("a picture");
    let mut encoder = Encoder::default();
    assert!(encoder.encode(&huge, SETTINGS, Instant::now()).is_err());
    // A tiny picture is enlarged.
    assert!(encoder.encode(&tiny, SETTINGS, Instant::now()).is_ok());
}

#[test]
fn another_size_or_a_request_gives_a_key_frame() {
    let (mut encoder, now) = (Encoder::default(), Instant::now());
    let mut decoder = Decoder::default();
    let mut is_key = |n, settings: Settings| {
        let picture = scene(320, 240, Format::Rgb8, n);
        let at = now + Duration::from_millis(67) * n;
        let payload = encoder.encode(&picture, settings, at).expect("encoded");
        // The same decoder follows the size.
        let decoded = decoder.decode(&payload.bytes, &Limits::default());
        let width = decoded.expect("valid").expect("a picture").width();
        assert_eq!(width, 80 * u32::from(settings.quarters));
        is_key_frame(&payload.bytes)
    };
    let half = Settings {
        quarters: 2,
        ..SETTINGS
    };
    let key = Settings {
        is_key: true,
        ..half
    };
    let faster = Settings {
        bytes_per_s: 90_000.0,
        ..half
    };
    let asked = [SETTINGS, SETTINGS, half, half, key, half, faster];
    let keys = (0..).zip(asked).map(|(n, settings)| is_key(n, settings));
    assert_eq!(
        keys.collect::<Vec<_>>(),
        [true, false, true, false, true, false, false]
    );
}

#[test]
fn the_rate_follows_the_settings() {
    let (mut encoder, start) = (Encoder::default(), Instant::now());
    let mut random = 1u32;
    // Noise, which no codec can predict, on top of the scene.
    let mut noisy = |n| {
        let picture = scene(320, 240, Format::Rgb8, n);
        let mut noise = |value: &u8| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            value.saturating_add((random >> 28) as u8)
        };
        let pixels: Vec<u8> = picture.pixels().iter().map(&mut noise).collect();
        Picture::new(320, 240, Format::Rgb8, pixels).expect("a picture")
    };
    let mut sent = |rate: f64, first: u32| -> f64 {
        let mut bytes = 0;
        for n in first..first + 60 {
            let settings = Settings {
                bytes_per_s: rate,
                ..SETTINGS
            };
            let at = start + Duration::from_secs(1) * n / 15;
            let payload = encoder.encode(&noisy(n), settings, at).expect("encoded");
            bytes += if n < first + 15 {
                0
            } else {
                payload.bytes.len()
            };
        }
        bytes as f64 / 3.0
    };
    for (first, rate) in [(0, 30_000.0), (60, 90_000.0), (120, 20_000.0)] {
        let used = sent(rate, first) / rate;
        assert!((0.7..1.15).contains(&used), "{rate}: {used}");
    }
}

#[test]
fn damaged_frames_are_errors_and_the_next_key_frame_continues() {
    let frames = encoded((320, 240), Format::Rgb8, 5);
    let (mut decoder, limits) = (Decoder::default(), Limits::default());
    let garbage = [[0, 0, 1, 0x67], [0xff; 4]].concat();
    decoder.decode(&garbage, &limits).expect_err("garbage");
    for frame in &frames {
        decoder.decode(frame, &limits).expect("valid");
    }
    let mut damaged = frames[0].to_vec();
    damaged.truncate(40);
    let _ = decoder.decode(&damaged, &limits);
    for frame in &frames {
        let picture = decoder.decode(frame, &limits).expect("valid");
        assert_eq!(picture.expect("a picture").width(), 320);
    }
}

#[test]
fn frames_wait_from_a_key_frame_on() {
    let frames = encoded((160, 120), Format::Rgb8, 4);
    let mut pending = Pending::new();
    assert!(pending.needs_key());
    assert!(
        !pending.on_frame(1, &frames[1], false),
        "begins with a key frame"
    );
    assert!(pending.on_frame(2, &frames[0], true));
    assert!(pending.on_frame(3, &frames[1], false));
    assert_eq!(pending.take(2), [frames[0].clone()]);
    assert_eq!(pending.take(2), Vec::<Bytes>::new());
    pending.on_gap();
    assert!(pending.needs_key() && !pending.on_frame(5, &frames[3], false));
    assert!(pending.on_frame(6, &frames[0], true));
    assert!(pending.on_frame(7, &frames[1], false));
    assert!(pending.on_frame(8, &frames[0], true));
    assert_eq!(pending.take(7).len(), 2, "every frame can be read");
    assert_eq!(pending.take(9).len(), 1);
    for (ordinal, is_key) in [(10, false), (11, true), (12, false)] {
        assert!(pending.on_frame(ordinal, &frames[1], is_key));
    }
    assert_eq!(
        pending.take(12).len(),
        2,
        "nothing before the key frame is needed"
    );
    pending.ask_for_key();
    assert!(pending.needs_key() && pending.on_frame(13, &frames[1], false));
    pending.leave_undecoded();
    assert!(pending.on_frame(14, &frames[2], false));
    assert_eq!(pending.take(14), Vec::<Bytes>::new());
}

#[test]
fn a_program_that_does_not_read_costs_little_memory() {
    let frame = Bytes::from(vec![0; 1000]);
    let mut pending = Pending::new();
    // Without a key frame, all are dropped.
    pending.on_frame(0, &frame, true);
    let kept = (1..)
        .take_while(|&n| pending.on_frame(n, &frame, false))
        .count();
    assert!(kept < 1000, "{kept}");
    assert!(pending.needs_key());
    // With key frames, the oldest are.
    for n in 1000..5000 {
        assert!(pending.on_frame(n, &frame, n % 100 == 0));
    }
    assert_eq!(pending.take(4000), Vec::<Bytes>::new());
    assert_eq!(pending.take(4999).len(), 100);
}

#[test]
fn sizes_beyond_the_limits_are_rejected_before_they_are_decoded() {
    let frames = encoded((640, 480), Format::Rgb8, 1);
    for limits in [
        Limits {
            max_pixels: 320 * 240,
            ..Limits::default()
        },
        Limits {
            max_bytes: 640 * 480,
            ..Limits::default()
        },
    ] {
        let error = Decoder::default()
            .decode(&frames[0], &limits)
            .expect_err("too large");
        assert!(error.to_string().contains("too large"), "{error}");
    }
}
