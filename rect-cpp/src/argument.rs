//! Checks the arguments that C passes: pointers, lengths and text.
use std::{
    ffi::{c_char, CStr},
    slice,
};

use crate::failure::Failure;

/// Returns a text that must not be NULL.
///
/// # Safety
/// `text` is NULL, or points to a text with a terminating zero byte that outlives `'a`.
pub unsafe fn text<'a>(name: &'static str, text: *const c_char) -> Result<&'a str, Failure> {
    // SAFETY: guaranteed by this function's caller.
    let value = unsafe { text_or_none(name, text) }?;
    value.ok_or_else(|| Failure::argument(name, "is NULL, or (in C++) contains a zero byte"))
}

/// Returns a text, or `None` for NULL.
///
/// # Safety
/// The same as for [`text`].
pub unsafe fn text_or_none<'a>(
    name: &'static str,
    text: *const c_char,
) -> Result<Option<&'a str>, Failure> {
    if text.is_null() {
        return Ok(None);
    }
    // SAFETY: the pointer is not NULL, and this function's caller guarantees the rest.
    let bytes = unsafe { CStr::from_ptr(text) };
    Ok(Some(utf8(name, bytes.to_bytes())?))
}

/// Returns the bytes as text, or a failure that gives the position of the first invalid byte.
pub fn utf8<'a>(name: &'static str, bytes: &'a [u8]) -> Result<&'a str, Failure> {
    std::str::from_utf8(bytes).map_err(|error| {
        let at = error.valid_up_to();
        Failure::argument(
            name,
            format!("is not UTF-8: the byte at offset {at} is invalid"),
        )
    })
}

/// Returns the `len` items from `first` on.
///
/// # Safety
/// `first` is NULL, or points to `len` items that outlive `'a`.
pub unsafe fn items<'a, T>(
    name: &'static str,
    first: *const T,
    len: usize,
) -> Result<&'a [T], Failure> {
    if len == 0 {
        return Ok(&[]);
    }
    if first.is_null() {
        return Err(Failure::argument(
            name,
            format!("is NULL, but its length is {len}"),
        ));
    }
    if !first.is_aligned() || len > isize::MAX as usize / size_of::<T>().max(1) {
        return Err(Failure::argument(
            name,
            format!("is misaligned, or its length {len} is impossible"),
        ));
    }
    // SAFETY: the pointer is neither NULL nor misaligned and the length is possible; this function's caller guarantees the
    // rest.
    Ok(unsafe { slice::from_raw_parts(first, len) })
}

/// Returns a value or function that must not be NULL.
pub fn require<T>(name: &'static str, value: Option<T>) -> Result<T, Failure> {
    value.ok_or_else(|| Failure::argument(name, "is NULL"))
}
