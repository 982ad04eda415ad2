//! Owns raw pictures as C gives and gets them.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::Arc,
};

use bytes::Bytes;
use rect::core::{
    codec::Limits,
    encoding,
    payload::ToPayload,
    picture::{Format as Pixels, Picture as Raw},
};

use crate::{
    argument::{items, there},
    boundary::{buffer, call, give, wanted, ErrorOut, Out},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::{hold, Buffer, PayloadView},
    text::{choice, number},
};

/// What a pixel is; 8 bits each.
#[repr(C)]
pub enum Format {
    /// Grey.
    Grey8 = 0,
    /// Red, green, blue.
    Rgb8 = 1,
    /// Red, green, blue, and how opaque it is; not multiplied with that.
    Rgba8 = 2,
}

const FORMATS: [(u32, Pixels); 3] = [
    (Format::Grey8 as u32, Pixels::Grey8),
    (Format::Rgb8 as u32, Pixels::Rgb8),
    (Format::Rgba8 as u32, Pixels::Rgba8),
];

/// A picture: rows of pixels without gaps, from the upper left. It is there until `rect_drop(&picture.id, ..)`.
#[repr(C)]
pub struct Picture {
    /// Its handle.
    pub id: u64,
    /// Pixels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// What a pixel is: a `rect_format`.
    pub format: u32,
    /// The pixels.
    pub pixels: *const u8,
    /// How many bytes of them.
    pub len: usize,
}

/// What may come out of one payload, whatever a peer sends.
#[repr(C)]
pub struct CodecLimits {
    /// The most bytes; 0: 64 MiB.
    pub max_bytes: usize,
    /// The most pixels of a picture; 0: 16 million.
    pub max_pixels: usize,
}

/// The longest encoding, with the zero byte at its end.
pub const ENCODING_BYTES: usize = 201;

const _: () = assert!(ENCODING_BYTES == encoding::MAX_BYTES + 1);

/// Where an encoding goes.
pub type EncodingOut<'a> = Out<'a, [c_char; ENCODING_BYTES]>;

struct Held(Raw);

impl Object for Held {
    const KIND: &'static str = "picture";
}

impl CodecLimits {
    /// As the library has them.
    pub fn read(given: Option<&Self>) -> Limits {
        let default = Limits::default();
        let or = |given: usize, default| if given == 0 { default } else { given };
        given.map_or(default, |given| Limits {
            max_bytes: or(given.max_bytes, default.max_bytes),
            max_pixels: or(given.max_pixels, default.max_pixels),
        })
    }
}

/// A picture that C gives.
///
/// # Safety
/// The pixels are as rect.h asks.
pub unsafe fn read(
    width: u32,
    height: u32,
    format: u32,
    pixels: *const c_void,
    len: usize,
) -> Result<Raw, Failure> {
    let format = choice("format", &FORMATS, format)?;
    // SAFETY: as this function asks.
    let pixels = unsafe { items("pixels", pixels.cast::<u8>(), len) }?;
    Ok(Raw::new(
        width,
        height,
        format,
        Bytes::copy_from_slice(pixels),
    )?)
}

/// An encoding, with a zero byte at its end.
pub fn give_encoding(text: &str, out: EncodingOut<'_>) -> Result<(), Failure> {
    give("encoding", out, buffer(text))
}

/// A picture as a payload, uncompressed: `rect_encode` makes it smaller. `len`: of the pixels, in bytes.
///
/// Thread: any.
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
        wanted("buffer", &buffer)?;
        // SAFETY: as rect.h asks.
        let picture = unsafe { read(width, height, format, pixels, len) }?;
        give("buffer", buffer, hold(picture.to_payload()?))
    })
}

/// The picture in a payload: a raw one, PNG, JPEG or WebP. `limits`: NULL for the default.
///
/// Thread: any. Takes as long as reading it.
#[no_mangle]
pub unsafe extern "C" fn rect_picture_read(
    payload: Option<&PayloadView>,
    limits: Option<&CodecLimits>,
    picture: Option<&mut MaybeUninit<Picture>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("picture", &picture)?;
        // SAFETY: as rect.h asks.
        let payload = unsafe { there("payload", payload)?.read() }?;
        let held = Arc::new(Held(payload.picture(&CodecLimits::read(limits))?));
        let (raw, shared) = (&held.0, held.clone());
        let view = Picture {
            id: handle::insert_shared(shared),
            width: raw.width(),
            height: raw.height(),
            format: number(&FORMATS, &raw.format()),
            pixels: raw.pixels().as_ptr(),
            len: raw.pixels().len(),
        };
        give("picture", picture, view)
    })
}
