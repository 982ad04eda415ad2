//! Owns the checks of what C gives: pointers, lengths, text.
use std::{
    ffi::{c_char, CStr},
    slice,
};

use crate::failure::Failure;

/// A text that has to be there.
///
/// # Safety
/// NULL, or a text with a zero byte at its end, that lives as long as what is returned is used.
pub unsafe fn text<'a>(name: &'static str, text: *const c_char) -> Result<&'a str, Failure> {
    // SAFETY: as this function asks.
    let given = unsafe { text_or_none(name, text) }?;
    given.ok_or_else(|| Failure::argument(name, "is NULL, or in C++ a text with a zero byte in it"))
}

/// A text, or NULL.
///
/// # Safety
/// As [`text`].
pub unsafe fn text_or_none<'a>(
    name: &'static str,
    text: *const c_char,
) -> Result<Option<&'a str>, Failure> {
    if text.is_null() {
        return Ok(None);
    }
    // SAFETY: not NULL, and as this function asks.
    let bytes = unsafe { CStr::from_ptr(text) };
    Ok(Some(utf8(name, bytes.to_bytes())?))
}

/// Text of these bytes.
pub fn utf8<'a>(name: &'static str, bytes: &'a [u8]) -> Result<&'a str, Failure> {
    std::str::from_utf8(bytes).map_err(|error| {
        let at = error.valid_up_to();
        Failure::argument(name, format!("is not UTF-8: its byte {at} is wrong"))
    })
}

/// So many items.
///
/// # Safety
/// NULL, or so many of them, that live as long as what is returned is used.
pub unsafe fn items<'a, T>(
    name: &'static str,
    first: *const T,
    len: usize,
) -> Result<&'a [T], Failure> {
    if len == 0 {
        return Ok(&[]);
    }
    if first.is_null() {
        return Err(Failure::argument(name, format!("is NULL, and {len} long")));
    }
    if !first.is_aligned() || len > isize::MAX as usize / size_of::<T>().max(1) {
        return Err(Failure::argument(
            name,
            format!("can't be {len} long there"),
        ));
    }
    // SAFETY: neither NULL nor misaligned nor larger than memory, and as this function asks.
    Ok(unsafe { slice::from_raw_parts(first, len) })
}

/// What is pointed to, or a function, which has to be there.
pub fn there<T>(name: &'static str, given: Option<T>) -> Result<T, Failure> {
    given.ok_or_else(|| Failure::argument(name, "is NULL"))
}
