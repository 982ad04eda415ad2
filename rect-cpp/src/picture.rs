//! Converts uncompressed pictures between C and the library.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::Arc,
};

use bytes::Bytes;
use rect_core::{
    codec::{
        picture::{Format as LibraryFormat, Picture as LibraryPicture},
        Limits,
    },
    message::{encoding, payload::ToPayload},
};

use crate::{
    argument::{items, require},
    boundary::{buffer, call, require_out, write_out, ErrorOut, Out},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::{into_c, Buffer, PayloadView},
    text::{choice, number},
};

/// The format of a pixel, with 8 bits per channel.
#[repr(C)]
pub enum Format {
    /// Grey: 1 byte per pixel.
    Grey8 = 0,
    /// Red, green and blue: 3 bytes per pixel.
    Rgb8 = 1,
    /// Red, green, blue and alpha, not premultiplied: 4 bytes per pixel.
    Rgba8 = 2,
}

const FORMATS: [(u32, LibraryFormat); 3] = [
    (Format::Grey8 as u32, LibraryFormat::Grey8),
    (Format::Rgb8 as u32, LibraryFormat::Rgb8),
    (Format::Rgba8 as u32, LibraryFormat::Rgba8),
];

/// An uncompressed picture: rows of pixels without padding, from the top left. It is valid until `rect_drop(&picture.id,
/// ..)`.
#[repr(C)]
pub struct Picture {
    /// The handle.
    pub id: u64,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The format of its pixels: a `rect_format`.
    pub format: u32,
    /// The pixels.
    pub pixels: *const u8,
    /// Size of `pixels` in bytes.
    pub len: usize,
}

/// Limits for decoding one payload. They protect against payloads that become extremely large.
#[repr(C)]
pub struct CodecLimits {
    /// Maximum size of the decoded payload in bytes. 0 means 64 MiB.
    pub max_bytes: usize,
    /// Maximum number of pixels of a picture. 0 means 16 million.
    pub max_pixels: usize,
}

/// Size of an encoding, including the terminating zero byte.
pub const ENCODING_BYTES: usize = 201;

const _: () = assert!(ENCODING_BYTES == encoding::MAX_BYTES + 1);

/// The caller's buffer for an encoding.
pub type EncodingOut<'a> = Out<'a, [c_char; ENCODING_BYTES]>;

struct OwnedPicture(LibraryPicture);

impl Object for OwnedPicture {
    const KIND: &'static str = "picture";
}

impl CodecLimits {
    /// Converts the limits for the library; `None` gives the defaults.
    pub fn read(given: Option<&Self>) -> Limits {
        let default = Limits::default();
        let or = |given: usize, default| if given == 0 { default } else { given };
        given.map_or(default, |given| Limits {
            max_bytes: or(given.max_bytes, default.max_bytes),
            max_pixels: or(given.max_pixels, default.max_pixels),
        })
    }
}

/// Copies a picture that C passes.
///
/// # Safety
/// `pixels` follows the rules of rect.h.
pub unsafe fn read(
    width: u32,
    height: u32,
    format: u32,
    pixels: *const c_void,
    len: usize,
) -> Result<LibraryPicture, Failure> {
    let format = choice("format", &FORMATS, format)?;
    // SAFETY: guaranteed by this function's caller.
    let pixels = unsafe { items("pixels", pixels.cast::<u8>(), len) }?;
    Ok(LibraryPicture::new(
        width,
        height,
        format,
        Bytes::copy_from_slice(pixels),
    )?)
}

/// Writes an encoding with a terminating zero byte.
pub fn write_encoding(text: &str, out: EncodingOut<'_>) -> Result<(), Failure> {
    write_out("encoding", out, buffer(text))
}

/// Makes a payload of a picture, without compressing it, and writes it to `buffer`. `format` is a `rect_format`; `len` is
/// the size of `pixels` in bytes. `rect_encode` compresses the payload.
///
/// Returns `RECT_CODE_CODEC` if `len` does not match the size of the picture. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_picture_payload(
    width: u32,
    height: u32,
    format: u32,
    pixels: *const c_void,
    len: usize,
    buffer: Option<&mut MaybeUninit<Buffer>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("buffer", &buffer)?;
        // SAFETY: the caller follows the rules of rect.h.
        let picture = unsafe { read(width, height, format, pixels, len) }?;
        write_out("buffer", buffer, into_c(picture.to_payload()?))
    })
}

/// Reads the picture from a payload: uncompressed, PNG, JPEG or WebP. `limits` may be NULL for the defaults.
///
/// Returns `RECT_CODE_PAYLOAD` if the payload is not a picture, and `RECT_CODE_CODEC` if it is damaged or exceeds the
/// limits. May be called on any thread. The time it takes depends on the size of the picture.
#[no_mangle]
pub unsafe extern "C" fn rect_picture_read(
    payload: Option<&PayloadView>,
    limits: Option<&CodecLimits>,
    picture: Option<&mut MaybeUninit<Picture>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("picture", &picture)?;
        // SAFETY: the caller follows the rules of rect.h.
        let payload = unsafe { require("payload", payload)?.read() }?;
        let owned = Arc::new(OwnedPicture(payload.picture(&CodecLimits::read(limits))?));
        let (raw, shared) = (&owned.0, owned.clone());
        let view = Picture {
            id: handle::insert_shared(shared),
            width: raw.width(),
            height: raw.height(),
            format: number(&FORMATS, &raw.format()),
            pixels: raw.pixels().as_ptr(),
            len: raw.pixels().len(),
        };
        write_out("picture", picture, view)
    })
}
