//! Encodes pictures as WebP: photographs take two thirds of the bytes of JPEG, for several times the work.
//!
//! libwebp encodes, because there is no lossy encoder in Rust. A decoder in Rust decodes what peers send.
use std::{io::Cursor, slice};

use image_webp::{DecodingError, WebPDecoder};
use libwebp_sys as sys;

use super::{damaged, number, Codec, CodecError, Limits};
use crate::{
    cause::Cause,
    codec::picture::{Format, Picture},
    message::{encoding::Encoding, payload::Payload},
};

/// The name of the codec.
pub const NAME: &str = "webp";
const FORMAT: &str = "WebP";
/// libwebp's effort, 0 to 6. Compared with its default, 4, this takes a quarter of the time for 4 to 7 percent more
/// bytes.
const METHOD: i32 = 2;
/// The maximum width and height of a WebP picture, in pixels.
const MAX_SIDE: u32 = 16383;

/// A lossy codec for raw pictures. Transparency is kept; grey pictures become coloured ones.
#[derive(Clone, Copy, Debug)]
pub struct Webp {
    quality: u8,
}

impl Webp {
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

impl Codec for Webp {
    fn name(&self) -> String {
        format!("{NAME}:{}", self.quality)
    }

    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError> {
        let picture = Picture::for_codec(NAME, payload)?;
        let (width, height) = (picture.width(), picture.height());
        if width.max(height) > MAX_SIDE {
            return Err(CodecError::TooLarge {
                format: FORMAT,
                found: format!("{width}x{height} pixels"),
                limit: format!("{MAX_SIDE} in a row or column"),
            });
        }
        let bytes = write(&picture, self.quality).map_err(|reason| CodecError::Failed {
            codec: NAME,
            reason: Cause::new(reason),
        })?;
        Ok(Payload::new(bytes, Encoding::WEBP))
    }

    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError> {
        read(&payload.bytes, limits).map(Picture::payload)
    }
}

/// Decodes any WebP, lossy or lossless. Of an animation, decodes the first picture.
pub(crate) fn read(bytes: &[u8], limits: &Limits) -> Result<Picture, CodecError> {
    let mut decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(invalid)?;
    let (width, height) = decoder.dimensions();
    let format = match decoder.has_alpha() {
        true => Format::Rgba8,
        false => Format::Rgb8,
    };
    let size = limits.picture(FORMAT, [width, height], format.channels())?;
    if !is_whole(bytes) {
        return Err(damaged(FORMAT, "it is truncated"));
    }
    decoder.set_memory_limit(limits.max_bytes);
    let mut pixels = vec![0; size];
    if decoder.output_buffer_size() != Some(size) {
        return Err(damaged(FORMAT, "its size is not possible"));
    }
    decoder.read_image(&mut pixels).map_err(invalid)?;
    Picture::new(width, height, format, pixels)
}

/// Returns whether the data has the length that its first eight bytes announce, which the library does not check.
fn is_whole(bytes: &[u8]) -> bool {
    let size = bytes.get(4..8).and_then(|size| size.try_into().ok());
    size.is_some_and(|size| u64::from(u32::from_le_bytes(size)) + 8 <= bytes.len() as u64)
}

fn invalid(error: DecodingError) -> CodecError {
    damaged(FORMAT, error)
}

fn write(picture: &Picture, quality: u8) -> Result<Vec<u8>, String> {
    let mut config =
        sys::WebPConfig::new_with_preset(sys::WebPPreset::WEBP_PRESET_DEFAULT, f32::from(quality))
            .map_err(|()| "libwebp rejects the settings".to_owned())?;
    config.method = METHOD;
    let mut frame = Frame::new(picture)?;
    let mut writer = Writer::new();
    frame.0.writer = Some(sys::WebPMemoryWrite);
    frame.0.custom_ptr = (&raw mut writer.0).cast();
    // SAFETY: libwebp's own functions have initialised `config` and `frame`. `custom_ptr` points to what
    // `WebPMemoryWrite` expects, which is not moved before the call returns.
    let done = unsafe { sys::WebPEncode(&config, &mut frame.0) };
    if done == 0 {
        return Err(format!("{:?}", frame.0.error_code));
    }
    Ok(writer.bytes().to_vec())
}

/// libwebp's copy of a picture, which is freed on drop.
struct Frame(sys::WebPPicture);

impl Frame {
    fn new(picture: &Picture) -> Result<Self, String> {
        let no_memory = |()| "not enough memory".to_owned();
        let mut frame = Self(sys::WebPPicture::new().map_err(no_memory)?);
        let side = |side: u32| i32::try_from(side).map_err(|error| error.to_string());
        frame.0.width = side(picture.width())?;
        frame.0.height = side(picture.height())?;
        let colors: Vec<u8>;
        let (pixels, import): (&[u8], unsafe extern "C" fn(_, _, _) -> _) = match picture.format() {
            Format::Grey8 => {
                colors = picture.pixels().iter().flat_map(|&g| [g, g, g]).collect();
                (&colors, sys::WebPPictureImportRGB)
            }
            Format::Rgb8 => (picture.pixels(), sys::WebPPictureImportRGB),
            Format::Rgba8 => (picture.pixels(), sys::WebPPictureImportRGBA),
        };
        let stride = pixels.len() / picture.height().max(1) as usize;
        let stride = i32::try_from(stride).map_err(|error| error.to_string())?;
        // SAFETY: `pixels` has `height` rows of `stride` bytes, as `Picture::new` checked, and they are copied.
        let done = unsafe { import(&mut frame.0, pixels.as_ptr(), stride) };
        match done {
            0 => Err(no_memory(())),
            _ => Ok(frame),
        }
    }
}

impl Drop for Frame {
    fn drop(&mut self) {
        // SAFETY: initialised in `new`; freeing one without pixels is allowed.
        unsafe { sys::WebPPictureFree(&mut self.0) };
    }
}

/// libwebp's output, which is freed on drop.
struct Writer(sys::WebPMemoryWriter);

impl Writer {
    fn new() -> Self {
        let mut writer = std::mem::MaybeUninit::uninit();
        // SAFETY: libwebp's own initialisation, which sets every field.
        Self(unsafe {
            sys::WebPMemoryWriterInit(writer.as_mut_ptr());
            writer.assume_init()
        })
    }

    fn bytes(&self) -> &[u8] {
        if self.0.mem.is_null() {
            return &[];
        }
        // SAFETY: `mem` has `size` bytes that libwebp has written, and lives as long as `self`.
        unsafe { slice::from_raw_parts(self.0.mem, self.0.size) }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // SAFETY: initialised in `new`.
        unsafe { sys::WebPMemoryWriterClear(&mut self.0) };
    }
}
