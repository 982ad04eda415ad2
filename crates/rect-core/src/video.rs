//! Video: pictures that are encoded as differences from the ones before, in H.264.
//!
//! A payload with the encoding `video/h264` is one frame: an access unit in the byte stream format of H.264, annex B, which
//! browsers, FFmpeg and viewers decode. A key frame begins with its parameter sets, and can be decoded on its own; every
//! other frame needs all the frames since the key frame before it.
//!
//! Cisco's OpenH264 encodes and decodes: it is built from source with a C++ compiler alone, on ARM with NEON. Of the codecs
//! that viewers support, VP9 needs twice the time for the same picture, and libvpx cannot be built by Cargo.
pub mod bitstream;
mod decoder;
mod encoder;
pub mod pending;

pub use decoder::Decoder;
pub use encoder::{Encoder, Settings};

/// Whether this program encodes and decodes video: the Cargo feature `video`.
pub const IS_AVAILABLE: bool = cfg!(feature = "video");

/// The name of the format in messages.
#[cfg(feature = "video")]
const FORMAT: &str = "H.264";
/// The smallest width and height of a picture that is sent as video, in pixels.
const MIN_SIDE: u32 = 16;
/// The largest width and height: those of level 5.2, which OpenH264 supports.
const MAX_SIDES: [u32; 2] = [3840, 2160];

/// Returns whether pictures of that size can be sent as video.
pub fn fits(width: u32, height: u32) -> bool {
    let (long, short) = (width.max(height), width.min(height));
    short >= MIN_SIDE && long <= MAX_SIDES[0] && short <= MAX_SIDES[1]
}

#[cfg(all(test, feature = "video"))]
mod tests;
