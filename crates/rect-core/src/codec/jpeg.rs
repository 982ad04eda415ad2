//! Encodes pictures as JPEG: photographs take a fifteenth to a twentieth of their raw size, with a loss that is barely
//! visible.
use jpeg_encoder::{ColorType, Encoder};
use zune_jpeg::{
    errors::DecodeErrors,
    zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions},
    JpegDecoder,
};

use super::{damaged, number, Codec, CodecError, Limits};
use crate::{
    cause::Cause,
    codec::picture::{Format, Picture},
    message::{encoding::Encoding, payload::Payload},
};

mod huffman;

/// The name of the codec.
pub const NAME: &str = "jpeg";
const FORMAT: &str = "JPEG";
/// The maximum number of scans. Progressive pictures have about ten, and decoding each takes as long as decoding the
/// whole picture.
const MAX_SCANS: usize = 32;

/// A lossy codec for raw pictures. Transparency is removed, because JPEG does not support it.
#[derive(Clone, Copy, Debug)]
pub struct Jpeg {
    quality: u8,
}

impl Jpeg {
    /// Creates a codec with a quality of 1 to 100. Other values are clamped.
    pub fn new(quality: u8) -> Self {
        Self {
            quality: quality.clamp(1, 100),
        }
    }

    pub(super) fn parse(option: Option<&str>) -> Result<Self, CodecError> {
        number(NAME, option, 1..=100, 80, "the quality, 1 to 100").map(Self::new)
    }
}

impl Codec for Jpeg {
    fn name(&self) -> String {
        format!("{NAME}:{}", self.quality)
    }

    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError> {
        let picture = Picture::for_codec(NAME, payload)?;
        let (width, height) = (picture.width(), picture.height());
        let (Ok(width), Ok(height)) = (u16::try_from(width), u16::try_from(height)) else {
            return Err(CodecError::TooLarge {
                format: FORMAT,
                found: format!("{width}x{height} pixels"),
                limit: "65535 in a row or column".to_owned(),
            });
        };
        let color = match picture.format() {
            Format::Grey8 => ColorType::Luma,
            Format::Rgb8 => ColorType::Rgb,
            Format::Rgba8 => ColorType::Rgba,
        };
        let mut bytes = Vec::new();
        Encoder::new(&mut bytes, self.quality)
            .encode(picture.pixels(), width, height, color)
            .map_err(|error| CodecError::Failed {
                codec: NAME,
                reason: Cause::new(error),
            })?;
        Ok(Payload::new(bytes, Encoding::JPEG))
    }

    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError> {
        read(&payload.bytes, limits).map(Picture::payload)
    }
}

/// Decodes any JPEG, also without Huffman tables, as USB cameras send it. A truncated picture is rejected instead of being filled with grey.
pub(crate) fn read(bytes: &[u8], limits: &Limits) -> Result<Picture, CodecError> {
    let bytes = &*huffman::complete(bytes);
    let side = usize::from(u16::MAX);
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(side)
        .set_max_height(side)
        .jpeg_set_max_scans(MAX_SCANS);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(invalid)?;
    let (width, height) = decoder
        .dimensions()
        .ok_or_else(|| damaged(FORMAT, "it has no dimensions"))?;
    let size = [width, height].map(|side| u32::try_from(side).unwrap_or(u32::MAX));
    let (format, space) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (Format::Grey8, ColorSpace::Luma),
        _ => (Format::Rgb8, ColorSpace::RGB),
    };
    limits.picture(FORMAT, size, format.channels())?;
    decoder.set_options(options.jpeg_set_out_colorspace(space));
    let pixels = decoder.decode().map_err(invalid)?;
    if !has_end(bytes) {
        return Err(damaged(FORMAT, "it is truncated"));
    }
    Picture::new(size[0], size[1], format, pixels)
}

/// Returns whether the last scan is complete, which the library does not check. Some cameras append padding.
fn has_end(bytes: &[u8]) -> bool {
    let last = |marker| bytes.windows(2).rposition(|two| two == [0xff, marker]);
    last(0xd9) > last(0xda)
}

fn invalid(error: DecodeErrors) -> CodecError {
    damaged(FORMAT, error)
}
