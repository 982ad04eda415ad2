//! Defines raw pictures: rows of pixels without padding, from top left. They are sent with the encoding
//! `application/octet-stream;picture;rgb8;640x480`.
use bytes::Bytes;
use fast_image_resize::{
    images::{Image, ImageRef},
    FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer,
};

use super::limits::Limits;
use crate::{
    cause::Cause,
    message::{
        codec_error::CodecError,
        encoding::{Encoding, EncodingKind},
        payload::{Payload, PayloadError, ToPayload},
    },
};

const KIND: &str = "picture";

/// The format of a pixel, 8 bits per channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// Grey.
    Grey8,
    /// Red, green, blue.
    Rgb8,
    /// Red, green, blue and opacity (not premultiplied).
    Rgba8,
}

/// A raw picture. Clones share the pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    width: u32,
    height: u32,
    format: Format,
    pixels: Bytes,
}

impl Format {
    /// Returns the number of bytes per pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Grey8 => 1,
            Self::Rgb8 => 3,
            Self::Rgba8 => 4,
        }
    }

    /// Returns the name that encodings use.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Grey8 => "grey8",
            Self::Rgb8 => "rgb8",
            Self::Rgba8 => "rgba8",
        }
    }

    fn named(text: &str) -> Option<Self> {
        let all = [Self::Grey8, Self::Rgb8, Self::Rgba8];
        all.into_iter().find(|format| format.as_str() == text)
    }
}

impl Picture {
    /// Creates a picture from `width * height * channels` bytes.
    ///
    /// # Errors
    /// Returns [`CodecError::Damaged`] if the number of bytes differs, or if there are no pixels.
    pub fn new(
        width: u32,
        height: u32,
        format: Format,
        pixels: impl Into<Bytes>,
    ) -> Result<Self, CodecError> {
        let pixels = pixels.into();
        let area = u64::from(width) * u64::from(height);
        let expected = area.checked_mul(format.channels() as u64);
        if area == 0 || expected != Some(pixels.len() as u64) {
            let (name, found) = (format.as_str(), pixels.len());
            let reason = format!("{found} bytes are not the size of {width}x{height} {name}");
            return Err(CodecError::Damaged {
                format: KIND,
                reason: Cause::new(reason),
            });
        }
        Ok(Self {
            width,
            height,
            format,
            pixels,
        })
    }

    /// Returns the width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Returns the height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Returns the format of the pixels.
    pub fn format(&self) -> Format {
        self.format
    }

    /// Returns the bytes of all rows, from the top.
    pub fn pixels(&self) -> &Bytes {
        &self.pixels
    }

    /// Returns the picture scaled to another size. Each pixel of a smaller picture is a weighted mean of the pixels
    /// that it replaces and of those around them.
    ///
    /// # Errors
    /// Returns a [`CodecError`] if the size is zero, or exceeds the default [`Limits`].
    pub fn scaled(&self, width: u32, height: u32) -> Result<Self, CodecError> {
        let size = [width, height];
        Limits::default().picture(KIND, size, self.format.channels())?;
        if size == [self.width, self.height] {
            return Ok(self.clone());
        }
        let pixel = match self.format {
            Format::Grey8 => PixelType::U8,
            Format::Rgb8 => PixelType::U8x3,
            Format::Rgba8 => PixelType::U8x4,
        };
        let mut to = Image::new(width, height, pixel);
        let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
        ImageRef::new(self.width, self.height, &self.pixels, pixel)
            .map_err(Cause::new)
            .and_then(|from| {
                let resized = Resizer::new().resize(&from, &mut to, &options);
                resized.map_err(Cause::new)
            })
            .map_err(|reason| CodecError::Failed {
                codec: KIND,
                reason,
            })?;
        Self::new(width, height, self.format, to.into_vec())
    }

    /// Reads a raw picture. Returns `None` if the payload is something else.
    pub(super) fn raw(payload: &Payload, limits: &Limits) -> Option<Result<Self, CodecError>> {
        let schema = payload.encoding.schema()?.strip_prefix(KIND)?;
        let schema = schema.strip_prefix(';')?;
        if payload.encoding.kind() != EncodingKind::Raw {
            return None;
        }
        let described = || {
            let (format, size) = schema.split_once(';')?;
            let (width, height) = size.split_once('x')?;
            let format = Format::named(format)?;
            Some((format, width.parse().ok()?, height.parse().ok()?))
        };
        Some(match described() {
            None => Err(CodecError::Damaged {
                format: KIND,
                reason: Cause::new(format!("{schema:?} is not a valid pixel format and size")),
            }),
            Some((format, width, height)) => limits
                .picture(KIND, [width, height], format.channels())
                .and_then(|_| Self::new(width, height, format, payload.bytes.clone())),
        })
    }

    /// Reads a raw picture for a codec that accepts nothing else.
    pub(super) fn for_codec(codec: &'static str, payload: &Payload) -> Result<Self, CodecError> {
        Self::raw(payload, &Limits::any()).unwrap_or_else(|| {
            Err(CodecError::Kind {
                codec,
                found: payload.encoding.clone(),
                expected: "raw pictures",
            })
        })
    }

    pub(crate) fn payload(self) -> Payload {
        let Self { width, height, .. } = self;
        let (raw, format) = (Encoding::RAW, self.format.as_str());
        let encoding = format!("{raw};{KIND};{format};{width}x{height}");
        Payload::new(self.pixels, Encoding::new(encoding))
    }
}

impl ToPayload for Picture {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        Ok(self.clone().payload())
    }

    fn into_payload(self) -> Result<Payload, PayloadError> {
        Ok(self.payload())
    }
}

#[cfg(test)]
mod tests;
