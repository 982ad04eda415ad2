//! Decodes untrusted video. No frame may make the decoder panic or exceed its limits, and after a damaged one it continues with
//! the next key frame. The input is a frame, or changes of the bytes of a valid video.
use std::{
    sync::OnceLock,
    time::{Duration, Instant},
};

use rect_core::{codec::{Limits, picture::{Format, Picture}}, video::{bitstream::{is_key_frame, units, Parameters}, Decoder, Encoder, Settings}};

const LIMITS: Limits = Limits {
    max_bytes: 1 << 22,
    max_pixels: 1 << 18,
};
const FRAMES: u32 = 6;

/// Returns a small video, of which the first and the fourth frame are key frames.
fn video() -> &'static Vec<Vec<u8>> {
    static VIDEO: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    VIDEO.get_or_init(|| {
        let (mut encoder, start) = (Encoder::default(), Instant::now());
        let encode = |n: u32| {
            let pixels: Vec<u8> = (0..64 * 48u32)
                .map(|at| (at * (n + 7) % 253) as u8)
                .collect();
            let picture = Picture::new(64, 48, Format::Grey8, pixels).expect("a picture");
            let settings = Settings {
                bytes_per_s: 20_000.0,
                frames_per_s: 15.0,
                quarters: 4,
                is_key: n == 3,
            };
            let now = start + Duration::from_millis(67) * n;
            let payload = encoder.encode(&picture, settings, now).expect("encodes");
            payload.bytes.to_vec()
        };
        (0..FRAMES).map(encode).collect()
    })
}

fn check(decoder: &mut Decoder, frame: &[u8]) {
    is_key_frame(frame);
    Parameters::of(frame);
    assert!(units(frame).map(<[u8]>::len).sum::<usize>() <= frame.len());
    if let Ok(Some(picture)) = decoder.decode(frame, &LIMITS) {
        assert!(picture.width() as usize * picture.height() as usize <= LIMITS.max_pixels);
    }
}

/// Runs the target on one input.
pub fn run(data: &[u8]) {
    let mut decoder = Decoder::default();
    let Some((&form, rest)) = data.split_first() else {
        return;
    };
    if form % 4 == 0 {
        check(&mut decoder, rest);
    } else {
        let mut frames = video().clone();
        // Each change: a frame, a place in it, and what the byte there is combined with.
        for change in rest.chunks_exact(4) {
            let frame = &mut frames[usize::from(change[0]) % FRAMES as usize];
            let place = usize::from(u16::from_le_bytes([change[1], change[2]])) % frame.len();
            frame[place] ^= change[3];
        }
        for frame in &frames {
            check(&mut decoder, frame);
        }
    }
    // The same decoder shows a valid video again.
    let mut last = None;
    for frame in video() {
        last = decoder.decode(frame, &LIMITS).expect("valid");
    }
    assert!(last.is_some());
}
