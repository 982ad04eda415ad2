//! Converts payloads between C and the library.
use std::{
    ffi::{c_char, c_void, CStr},
    mem::MaybeUninit,
};

use bytes::Bytes;
use rect::{Encoding, Json, Payload, ToPayload, Value};
use rect_core::{
    cause::Cause,
    message::{encoding, payload::PayloadError},
};

use crate::{
    argument::{self, items, utf8},
    boundary::{call, write_out, ErrorOut},
    failure::{Code, Failure},
    handle::{self, Object},
    text::Text,
};

/// A payload: bytes and their encoding.
///
/// A function copies the payload that a program passes to it before it returns. A payload that a program receives is valid
/// as long as the object that it belongs to.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct PayloadView {
    /// The first byte; may be NULL if `len` is 0.
    pub data: *const c_void,
    /// Size in bytes.
    pub len: usize,
    /// The encoding, e.g. `application/json`. If it is empty, the payload is arbitrary bytes (`zenoh/bytes`).
    pub encoding: Text,
}

/// The kind of a payload, according to its encoding, which is compared like any media type, without case and without parameters.
#[repr(C)]
pub enum EncodingKind {
    /// Anything else, also text in another character set than UTF-8.
    Other = 0,
    /// JSON: `application/json`, `text/json`, or a type that ends in `+json`.
    Json = 1,
    /// CBOR: `application/cbor`, or a type that ends in `+cbor`.
    Cbor = 2,
    /// Text in UTF-8: `text/...`, or `zenoh/string`.
    Text = 3,
    /// A picture: `image/png`.
    Png = 4,
    /// A picture: `image/jpeg`.
    Jpeg = 5,
    /// A picture: `image/webp`.
    Webp = 6,
    /// A frame of a video: `video/h264`.
    H264 = 7,
    /// A raw picture or array, or any bytes: `application/octet-stream`.
    Raw = 8,
}

impl EncodingKind {
    fn of(encoding: &Encoding) -> Self {
        match encoding.kind() {
            rect::EncodingKind::Json => Self::Json,
            rect::EncodingKind::Cbor => Self::Cbor,
            rect::EncodingKind::Text => Self::Text,
            rect::EncodingKind::Png => Self::Png,
            rect::EncodingKind::Jpeg => Self::Jpeg,
            rect::EncodingKind::Webp => Self::Webp,
            rect::EncodingKind::H264 => Self::H264,
            rect::EncodingKind::Raw => Self::Raw,
            _ => Self::Other,
        }
    }
}

/// A payload with a handle of its own. Release it with `rect_drop(&buffer.id, ..)`.
#[repr(C)]
pub struct Buffer {
    /// The handle.
    pub id: u64,
    /// The payload.
    pub payload: PayloadView,
}

impl PayloadView {
    /// The absence of a payload.
    pub const EMPTY: Self = Self {
        data: std::ptr::null(),
        len: 0,
        encoding: Text::NONE,
    };

    /// Points to a payload, which must outlive the result.
    pub fn of(payload: &Payload) -> Self {
        Self {
            data: payload.bytes.as_ptr().cast(),
            len: payload.bytes.len(),
            encoding: Text::of(payload.encoding.as_str()),
        }
    }

    /// Returns the bytes and their encoding.
    ///
    /// # Safety
    /// The pointers follow the rules of rect.h.
    // Inlined, like `named` and `read`: they run once per message, and each call would otherwise move a large result.
    #[inline(always)]
    pub unsafe fn parts(&self) -> Result<(&[u8], Encoding), Failure> {
        // SAFETY: guaranteed by this function's caller.
        let bytes = unsafe { items("payload.data", self.data.cast::<u8>(), self.len) }?;
        let Text { data, len } = self.encoding;
        // SAFETY: guaranteed by this function's caller.
        let encoding = unsafe { items("payload.encoding", data, len) }?;
        Ok((bytes, named(encoding)?))
    }

    /// Copies the payload for the library.
    ///
    /// # Safety
    /// The pointers follow the rules of rect.h.
    #[inline(always)]
    pub unsafe fn read(&self) -> Result<Payload, Failure> {
        // SAFETY: guaranteed by this function's caller.
        let (bytes, encoding) = unsafe { self.parts() }?;
        // Most text is ASCII, which takes a third of the time to check.
        if encoding.is_text() && !bytes.is_ascii() {
            utf8("payload.data", bytes)?;
        }
        Ok(Payload::new(Bytes::copy_from_slice(bytes), encoding))
    }
}

/// Returns the encoding with this name. The four most common ones need neither an allocation nor a check for UTF-8.
#[inline(always)]
pub fn named(text: &[u8]) -> Result<Encoding, Failure> {
    static COMMON: [Encoding; 4] = [
        Encoding::JSON,
        Encoding::TEXT,
        Encoding::BYTES,
        Encoding::CBOR,
    ];
    if text.is_empty() {
        return Ok(Encoding::BYTES);
    }
    let common = COMMON
        .iter()
        .find(|encoding| encoding.as_str().as_bytes() == text);
    if let Some(common) = common {
        return Ok(common.clone());
    }
    if text.len() > encoding::MAX_BYTES {
        let max = encoding::MAX_BYTES;
        let problem = format!("is {} bytes long; the maximum is {max}", text.len());
        return Err(Failure::argument("payload.encoding", problem));
    }
    Ok(Encoding::new(utf8("payload.encoding", text)?.to_owned()))
}

struct OwnedBuffer {
    _payload: Payload,
}

impl Object for OwnedBuffer {
    const KIND: &'static str = "buffer";
}

/// Moves a payload into the handle table and returns its C form.
pub fn into_c(payload: Payload) -> Buffer {
    let view = PayloadView::of(&payload);
    Buffer {
        id: handle::insert(OwnedBuffer { _payload: payload }),
        payload: view,
    }
}

/// Returns a payload in a form that C programs can read: text as text, and other values as JSON rather than CBOR, unless JSON cannot
/// express them.
pub fn readable(payload: Payload) -> Payload {
    if payload.encoding.kind() != rect::EncodingKind::Cbor {
        return payload;
    }
    match payload.value() {
        Ok(Value::String(text)) => Payload::new(text, Encoding::TEXT),
        Ok(value) => Json(value).to_payload().unwrap_or(payload),
        Err(_) => payload,
    }
}

/// Does the same as [`readable`], and returns an empty payload for null.
pub fn readable_or_empty(payload: Payload) -> Payload {
    match payload.value::<Value>() {
        Ok(Value::Null) => Payload::new("", Encoding::BYTES),
        _ => readable(payload),
    }
}

/// Returns the text of a payload whose encoding is a kind of text.
fn text<'a>(bytes: &'a [u8], found: &Encoding) -> Result<&'a str, PayloadError> {
    if !found.is_text() {
        let (expected, found) = ("text in UTF-8", found.clone());
        return Err(PayloadError::Mismatch { expected, found });
    }
    std::str::from_utf8(bytes).map_err(|error| PayloadError::Read {
        format: "text",
        reason: Cause::new(error),
    })
}

/// Makes a payload of a text with a terminating zero byte, encoding `text/plain`. NULL is an empty text. The payload points
/// to `text`, which must outlive it.
#[no_mangle]
pub unsafe extern "C" fn rect_payload_text(text: *const c_char) -> PayloadView {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe { of_text(text, "text/plain") }
}

/// Makes a payload of JSON that the program has written, encoding `application/json`. NULL is an empty text. The payload
/// points to `text`, which must outlive it.
#[no_mangle]
pub unsafe extern "C" fn rect_payload_json(text: *const c_char) -> PayloadView {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe { of_text(text, "application/json") }
}

/// Makes a payload of arbitrary bytes, encoding `zenoh/bytes`. The payload points to `data`, which must outlive it.
#[no_mangle]
pub extern "C" fn rect_payload_bytes(data: *const c_void, len: usize) -> PayloadView {
    let encoding = Text::of("zenoh/bytes");
    PayloadView {
        data,
        len,
        encoding,
    }
}

/// # Safety
/// `text` is NULL or a text with a terminating zero byte.
unsafe fn of_text(text: *const c_char, encoding: &'static str) -> PayloadView {
    let len = if text.is_null() {
        0
    } else {
        // SAFETY: the pointer is not NULL, and this function's caller guarantees the rest.
        unsafe { CStr::from_ptr(text) }.count_bytes()
    };
    PayloadView {
        data: text.cast(),
        len,
        encoding: Text::of(encoding),
    }
}

/// Writes what the bytes of a payload are, by its encoding, to `out`. The bytes are not read.
///
/// May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_payload_kind(
    payload: Option<&PayloadView>,
    out: Option<&mut MaybeUninit<EncodingKind>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let (_, encoding) = unsafe { argument::require("payload", payload)?.parts() }?;
        write_out("kind", out, EncodingKind::of(&encoding))
    })
}

/// Writes the text of a payload to `out`. The text is valid as long as the payload.
///
/// Returns `RECT_CODE_PAYLOAD` if the encoding is not a kind of text, or if the bytes are not UTF-8. May be called on any
/// thread.
#[no_mangle]
pub unsafe extern "C" fn rect_payload_as_text(
    payload: Option<&PayloadView>,
    out: Option<&mut MaybeUninit<Text>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let (bytes, encoding) = unsafe { argument::require("payload", payload)?.parts() }?;
        write_out("text", out, Text::of(text(bytes, &encoding)?))
    })
}
