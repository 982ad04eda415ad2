//! Measures the processor time for a picture of a camera: as video, which is encoded and decoded, and as JPEG.
//!
//! Prints one line of JSON for each size. `packaging/footprint/run` runs it on an emulated Raspberry Pi 3B, where processor time
//! counts instructions.
use std::time::{Duration, Instant};

use rect_core::{
    codec::{
        jpeg::Jpeg,
        picture::{Format, Picture},
        Codec, Limits,
    },
    message::payload::ToPayload,
    video::{Decoder, Encoder, Settings},
};

const SIZES: [(u32, u32); 2] = [(320, 240), (640, 480)];
const SETTINGS: Settings = Settings {
    bytes_per_s: 26_000.0,
    frames_per_s: 15.0,
    quarters: 4,
    is_key: false,
};
/// The number of pictures that are measured, after the first ones.
const PICTURES: u32 = 30;
const WARM_UP: u32 = 5;
/// The quality of JPEG, with which a picture of 640x480 has about 20 kB.
const QUALITY: u8 = 45;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for (width, height) in SIZES {
        let (mut encoder, mut decoder) = (Encoder::default(), Decoder::default());
        let (mut encode, mut decode, mut jpeg) = Default::default();
        let start = Instant::now();
        for n in 0..WARM_UP + PICTURES {
            let picture = scene(width, height, n)?;
            let at = start + Duration::from_secs(1) * n / 15;
            let (frame, encoded) = timed(|| encoder.encode(&picture, SETTINGS, at));
            let frame = frame?;
            let (decoded, took) = timed(|| decoder.decode(&frame.bytes, &Limits::default()));
            decoded?.ok_or("the frame has no picture")?;
            let raw = picture.to_payload()?;
            let (still, as_jpeg) = timed(|| Jpeg::new(QUALITY).encode(&raw));
            still?;
            if n >= WARM_UP {
                encode += encoded;
                decode += took;
                jpeg += as_jpeg;
            }
        }
        let [encode, decode, jpeg] =
            [encode, decode, jpeg].map(|time: Duration| (time / PICTURES).as_micros());
        println!(
            "{{\"video\": \"{width}x{height}\", \"encode_us\": {encode}, \"decode_us\": {decode}, \"jpeg_us\": {jpeg}}}"
        );
    }
    Ok(())
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let start = Instant::now();
    let outcome = work();
    (outcome, start.elapsed())
}

/// Returns a picture with coarse and fine structures that moves by 3 and 2 pixels for each number, and the noise of a sensor.
fn scene(width: u32, height: u32, number: u32) -> Result<Picture, rect_core::codec::CodecError> {
    let mut random = number.wrapping_mul(2_654_435_761) | 1;
    let mut pixels = Vec::with_capacity((width * height * 3) as usize);
    for (x, y) in (0..width * height).map(|n| (n % width, n / width)) {
        let (x, y) = (x + number * 3, y + number * 2);
        let coarse = ((x / 37 * 31) ^ (y / 29 * 57)) % 128;
        let fine = ((x / 3 * 7) ^ (y / 2 * 5)) % 24;
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        let value = 40 + coarse + fine + random % 7;
        pixels.extend([value, value * 3 / 4, 255 - value].map(|value| value.min(255) as u8));
    }
    Picture::new(width, height, Format::Rgb8, pixels)
}
