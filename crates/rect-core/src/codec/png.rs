//! Encodes pictures as PNG, without loss. Photographs take about half of their raw size.
use std::io::Cursor;

use png::{BitDepth, ColorType, Compression, Decoder, Encoder, Transformations};

use super::{damaged, no_option, Codec, CodecError, Limits};
use crate::{
    cause::Cause,
    codec::picture::{Format, Picture},
    message::{encoding::Encoding, payload::Payload},
};

/// The name of the codec.
pub const NAME: &str = "png";
const FORMAT: &str = "PNG";

/// A lossless codec for raw pictures.
#[derive(Clone, Copy, Debug, Default)]
pub struct Png;

impl Png {
    pub(super) fn parse(option: Option<&str>) -> Result<Self, CodecError> {
        no_option(NAME, option)?;
        Ok(Self)
    }
}

impl Codec for Png {
    fn name(&self) -> String {
        NAME.to_owned()
    }

    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError> {
        let picture = Picture::for_codec(NAME, payload)?;
        let bytes = write(&picture).map_err(|error| CodecError::Failed {
            codec: NAME,
            reason: Cause::new(error),
        })?;
        Ok(Payload::new(bytes, Encoding::PNG))
    }

    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError> {
        read(&payload.bytes, limits).map(Picture::payload)
    }
}

fn write(picture: &Picture) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, picture.width(), picture.height());
    encoder.set_compression(Compression::Fast);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_color(match picture.format() {
        Format::Grey8 => ColorType::Grayscale,
        Format::Rgb8 => ColorType::Rgb,
        Format::Rgba8 => ColorType::Rgba,
    });
    let mut writer = encoder.write_header()?;
    writer.write_image_data(picture.pixels())?;
    writer.finish()?;
    Ok(bytes)
}

/// Decodes any PNG. 16 bits per channel become 8, and palettes become colours.
pub(crate) fn read(bytes: &[u8], limits: &Limits) -> Result<Picture, CodecError> {
    let memory = png::Limits {
        bytes: limits.max_bytes,
    };
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), memory);
    decoder.set_transformations(Transformations::normalize_to_color8());
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let info = decoder.read_header_info().map_err(invalid)?;
    let (width, height) = (info.width, info.height);
    // Checks the limit for four bytes per pixel, which is the maximum even if a later chunk adds transparency.
    limits.picture(FORMAT, [width, height], Format::Rgba8.channels())?;
    let mut reader = decoder.read_info().map_err(invalid)?;
    let (color, _) = reader.output_color_type();
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| damaged(FORMAT, "its size is not possible"))?;
    let mut pixels = vec![0; limits.bytes(FORMAT, size as u64)?];
    reader.next_frame(&mut pixels).map_err(invalid)?;
    // Rejects a picture whose end is missing.
    reader.finish().map_err(invalid)?;
    let (format, pixels) = match color {
        ColorType::Grayscale => (Format::Grey8, pixels),
        ColorType::GrayscaleAlpha => (Format::Rgba8, grey_alpha_to_rgba(&pixels)),
        ColorType::Rgb | ColorType::Indexed => (Format::Rgb8, pixels),
        ColorType::Rgba => (Format::Rgba8, pixels),
    };
    Picture::new(width, height, format, pixels)
}

/// Converts grey pixels with opacity to [`Format::Rgba8`].
fn grey_alpha_to_rgba(pixels: &[u8]) -> Vec<u8> {
    let pixels = pixels.chunks_exact(2);
    pixels.flat_map(|p| [p[0], p[0], p[0], p[1]]).collect()
}

fn invalid(error: png::DecodingError) -> CodecError {
    damaged(FORMAT, error)
}
