//! Owns payloads as C gives and gets them.
use std::{
    ffi::{c_char, c_void, CStr},
    mem::MaybeUninit,
};

use bytes::Bytes;
use rect::{
    core::{encoding, payload::PayloadError},
    Encoding, Payload,
};

use crate::{
    argument::{self, items, utf8},
    boundary::{call, give, ErrorOut},
    failure::{Code, Failure},
    handle::{self, Object},
    text::Text,
};

/// Bytes, and what they are. What a program gives is copied before the call returns; what it gets lives as long as what it
/// is of.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct PayloadView {
    /// The first byte.
    pub data: *const c_void,
    /// How many.
    pub len: usize,
    /// What they are, as `application/json`; of length 0: any bytes.
    pub encoding: Text,
}

/// A payload of its own. `rect_drop(&buffer.id, ..)` when it is not needed any more.
#[repr(C)]
pub struct Buffer {
    /// Its handle.
    pub id: u64,
    /// The payload.
    pub payload: PayloadView,
}

impl PayloadView {
    /// Of a payload that outlives it.
    pub fn of(payload: &Payload) -> Self {
        Self {
            data: payload.bytes.as_ptr().cast(),
            len: payload.bytes.len(),
            encoding: Text::of(payload.encoding.as_str()),
        }
    }

    /// The bytes, and what they are.
    ///
    /// # Safety
    /// It is as rect.h asks.
    // As `named` and `read`: once a message, and what they give is large, and would be moved from one to the next.
    #[inline(always)]
    pub unsafe fn parts(&self) -> Result<(&[u8], Encoding), Failure> {
        // SAFETY: as this function asks.
        let bytes = unsafe { items("payload.data", self.data.cast::<u8>(), self.len) }?;
        let Text { data, len } = self.encoding;
        // SAFETY: as this function asks.
        let encoding = unsafe { items("payload.encoding", data, len) }?;
        Ok((bytes, named(encoding)?))
    }

    /// As the library has them.
    ///
    /// # Safety
    /// It is as rect.h asks.
    #[inline(always)]
    pub unsafe fn read(&self) -> Result<Payload, Failure> {
        // SAFETY: as this function asks.
        let (bytes, encoding) = unsafe { self.parts() }?;
        // ASCII, as most text is, is seen in a third of the steps.
        if encoding.is_text() && !bytes.is_ascii() {
            utf8("payload.data", bytes)?;
        }
        Ok(Payload::new(Bytes::copy_from_slice(bytes), encoding))
    }
}

/// The usual ones cost no memory, and no look at each byte.
#[inline(always)]
pub fn named(text: &[u8]) -> Result<Encoding, Failure> {
    static USUAL: [Encoding; 4] = [
        Encoding::JSON,
        Encoding::TEXT,
        Encoding::BYTES,
        Encoding::CBOR,
    ];
    if text.is_empty() {
        return Ok(Encoding::BYTES);
    }
    let known = USUAL.iter().find(|one| one.as_str().as_bytes() == text);
    if let Some(known) = known {
        return Ok(known.clone());
    }
    if text.len() > encoding::MAX_BYTES {
        let most = encoding::MAX_BYTES;
        let wrong = format!("is {} bytes long, and may have {most}", text.len());
        return Err(Failure::argument("payload.encoding", wrong));
    }
    Ok(Encoding::new(utf8("payload.encoding", text)?.to_owned()))
}

struct Held {
    _payload: Payload,
}

impl Object for Held {
    const KIND: &'static str = "buffer";
}

/// Gives C a payload.
pub fn hold(payload: Payload) -> Buffer {
    let shown = PayloadView::of(&payload);
    Buffer {
        id: handle::insert(Held { _payload: payload }),
        payload: shown,
    }
}

/// The text of what says that it is text.
fn text<'a>(bytes: &'a [u8], found: &Encoding) -> Result<&'a str, PayloadError> {
    if !found.is_text() {
        let (wanted, found) = ("text", found.clone());
        return Err(PayloadError::Other { wanted, found });
    }
    std::str::from_utf8(bytes).map_err(|error| PayloadError::Read {
        what: "text",
        reason: error.to_string(),
    })
}

/// A payload of text; NULL is no text. It points to what is given.
#[no_mangle]
pub unsafe extern "C" fn rect_payload_text(text: *const c_char) -> PayloadView {
    // SAFETY: as rect.h asks.
    unsafe { of_text(text, "text/plain") }
}

/// A payload of JSON, as some JSON library has written it; NULL is no text. It points to what is given.
#[no_mangle]
pub unsafe extern "C" fn rect_payload_json(text: *const c_char) -> PayloadView {
    // SAFETY: as rect.h asks.
    unsafe { of_text(text, "application/json") }
}

/// A payload of any bytes. It points to what is given.
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
/// NULL, or a text with a zero byte at its end.
unsafe fn of_text(text: *const c_char, encoding: &'static str) -> PayloadView {
    let len = if text.is_null() {
        0
    } else {
        // SAFETY: not NULL, and as this function asks.
        unsafe { CStr::from_ptr(text) }.count_bytes()
    };
    PayloadView {
        data: text.cast(),
        len,
        encoding: Text::of(encoding),
    }
}

/// The text in a payload: RECT_CODE_PAYLOAD if it says that it is something else, or is no UTF-8. It lives as long as the
/// payload.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_payload_as_text(
    payload: Option<&PayloadView>,
    out: Option<&mut MaybeUninit<Text>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        let (bytes, encoding) = unsafe { argument::there("payload", payload)?.parts() }?;
        give("text", out, Text::of(text(bytes, &encoding)?))
    })
}
