//! Owns raw pictures: rows of pixels without gaps, from the upper left, and how they are sent:
//! `application/octet-stream;picture;rgb8;640x480`.
use bytes::Bytes;
use fast_image_resize::{
    images::{Image, ImageRef},
    FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer,
};

use super::{
    codec::{jpeg, png, webp, CodecError, Limits},
    encoding::Encoding,
    payload::{Payload, PayloadError, ToPayload},
};

const KIND: &str = "picture";

/// What a pixel is; 8 bits each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// Grey.
    Grey8,
    /// Red, green, blue.
    Rgb8,
    /// Red, green, blue, and how opaque it is; not multiplied with that.
    Rgba8,
}

/// A picture as a camera gives it. Cloning shares the pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    width: u32,
    height: u32,
    format: Format,
    pixels: Bytes,
}

impl Format {
    /// Bytes of a pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Grey8 => 1,
            Self::Rgb8 => 3,
            Self::Rgba8 => 4,
        }
    }

    /// As in an encoding.
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
    /// Of pixels, `width * height * channels` bytes.
    ///
    /// # Errors
    /// Another number of bytes, or none ([`CodecError::Damaged`]).
    pub fn new(
        width: u32,
        height: u32,
        format: Format,
        pixels: impl Into<Bytes>,
    ) -> Result<Self, CodecError> {
        let pixels = pixels.into();
        let area = u64::from(width) * u64::from(height);
        let wanted = area.checked_mul(format.channels() as u64);
        if area == 0 || wanted != Some(pixels.len() as u64) {
            let (name, found) = (format.as_str(), pixels.len());
            let reason = format!("{found} bytes are not the pixels of {width}x{height} {name}");
            return Err(CodecError::Damaged {
                format: KIND,
                reason,
            });
        }
        Ok(Self {
            width,
            height,
            format,
            pixels,
        })
    }

    /// Pixels of a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// What a pixel is.
    pub fn format(&self) -> Format {
        self.format
    }

    /// All rows, from above.
    pub fn pixels(&self) -> &Bytes {
        &self.pixels
    }

    /// The same in another size; each pixel of a smaller one is the mean of those that it stands for.
    ///
    /// # Errors
    /// No pixel, or more than [`Limits`] have by default.
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
            .map_err(|error| error.to_string())
            .and_then(|from| {
                Resizer::new()
                    .resize(&from, &mut to, &options)
                    .map_err(|error| error.to_string())
            })
            .map_err(|reason| CodecError::Failed {
                codec: KIND,
                reason,
            })?;
        Self::new(width, height, self.format, to.into_vec())
    }

    /// A raw one; `None`: the payload is something else.
    pub(super) fn raw(payload: &Payload, limits: &Limits) -> Option<Result<Self, CodecError>> {
        let schema = payload.encoding.schema()?.strip_prefix(KIND)?;
        let schema = schema.strip_prefix(';')?;
        if payload.encoding.media_type() != Encoding::RAW {
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
                reason: format!("{schema:?} does not say how its pixels lie"),
            }),
            Some((format, width, height)) => limits
                .picture(KIND, [width, height], format.channels())
                .and_then(|_| Self::new(width, height, format, payload.bytes.clone())),
        })
    }

    /// A raw one, for a codec that takes nothing else.
    pub(super) fn wanted_by(codec: &'static str, payload: &Payload) -> Result<Self, CodecError> {
        Self::raw(payload, &Limits::any()).unwrap_or_else(|| {
            Err(CodecError::Kind {
                codec,
                found: payload.encoding.clone(),
                wanted: "raw pictures",
            })
        })
    }

    pub(super) fn payload(self) -> Payload {
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

impl Payload {
    /// As a picture: a raw one, PNG, JPEG or WebP.
    ///
    /// # Errors
    /// It is something else ([`PayloadError::Other`]), damaged or too large ([`PayloadError::Codec`]).
    pub fn picture(&self, limits: &Limits) -> Result<Picture, PayloadError> {
        let bytes = &self.bytes;
        let picture = match self.encoding.media_type() {
            "image/png" => png::read(bytes, limits),
            "image/jpeg" => jpeg::read(bytes, limits),
            "image/webp" => webp::read(bytes, limits),
            _ => Picture::raw(self, limits).ok_or_else(|| self.other("a picture"))?,
        };
        Ok(picture?)
    }
}

#[cfg(test)]
mod tests;
