//! Owns the border itself: no panic goes into C, and a failure becomes a code and a text.
use std::{
    any::Any,
    ffi::c_char,
    mem::MaybeUninit,
    panic::{catch_unwind, AssertUnwindSafe},
};

use crate::failure::{Code, Failure};

/// The longest text of an error, with the zero byte at its end.
pub const ERROR_BYTES: usize = 1024;

/// Why a call did not do it. Every call that may fail takes a pointer to one, or NULL; it is written when the call fails,
/// and left alone otherwise. It owns nothing.
#[repr(C)]
pub struct ErrorOut {
    /// What the call returns, too.
    pub code: Code,
    /// For people: one line of UTF-8, with a zero byte at its end. What is longer is cut.
    pub text: [c_char; ERROR_BYTES],
}

/// Where C wants the reason of a failure; NULL: nowhere.
pub type Reason<'a> = Option<&'a mut MaybeUninit<ErrorOut>>;

/// Where C wants what a call gives.
pub type Out<'a, T> = Option<&'a mut MaybeUninit<T>>;

/// Runs the inside of an entry point.
pub fn call(reason: Reason<'_>, inside: impl FnOnce() -> Result<(), Failure>) -> Code {
    // What was half done is in objects behind locks that are taken over, or is dropped.
    let failure = match catch_unwind(AssertUnwindSafe(inside)) {
        Ok(Ok(())) => return Code::Ok,
        Ok(Err(failure)) => failure,
        Err(panic) => Failure::Fault(said(&*panic)),
    };
    let code = failure.code();
    if let Some(reason) = reason {
        let text = buffer(&failure.text());
        reason.write(ErrorOut { code, text });
    }
    code
}

/// Writes what a call gives.
pub fn give<T>(name: &'static str, out: Out<'_, T>, value: T) -> Result<(), Failure> {
    wanted(name, &out)?;
    if let Some(out) = out {
        out.write(value);
    }
    Ok(())
}

/// Whether there is anywhere to write to; asked before anything is done that could not be undone.
pub fn wanted<T>(name: &'static str, out: &Out<'_, T>) -> Result<(), Failure> {
    let is_null = out.is_none();
    is_null
        .then(|| Failure::argument(name, "is NULL: it is where the result goes"))
        .map_or(Ok(()), Err)
}

fn said(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without text").to_owned()
}

/// As much of a text as there is room for, up to the end of a character, and a zero byte at its end.
pub fn buffer<const BYTES: usize>(text: &str) -> [c_char; BYTES] {
    let mut buffer = [0; BYTES];
    let end = (0..BYTES.min(text.len() + 1))
        .rev()
        .find(|&end| text.is_char_boundary(end));
    let shown = text.get(..end.unwrap_or(0)).unwrap_or_default();
    for (to, byte) in buffer.iter_mut().zip(shown.bytes()) {
        // A zero byte would end it.
        *to = if byte == 0 { b' ' } else { byte } as c_char;
    }
    buffer
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(error: &ErrorOut) -> String {
        let bytes = error.text.iter().take_while(|&&c| c != 0);
        String::from_utf8(bytes.map(|&c| c as u8).collect()).expect("UTF-8")
    }

    #[test]
    fn a_panic_is_an_error_and_not_the_end() {
        let mut reason = MaybeUninit::uninit();
        let code = call(Some(&mut reason), || panic!("of number {}", 7));
        assert_eq!(code, Code::Fault);
        // SAFETY: the call failed, so that it is written.
        let error = unsafe { reason.assume_init() };
        assert!(read(&error).ends_with("of number 7"), "{}", read(&error));
    }

    #[test]
    fn a_long_text_is_cut_between_characters_and_ends_in_a_zero() {
        let long = format!("a{}", "ä".repeat(ERROR_BYTES));
        let mut reason = MaybeUninit::uninit();
        call(Some(&mut reason), || Err(Failure::argument("x", long)));
        // SAFETY: the call failed, so that it is written.
        let error = unsafe { reason.assume_init() };
        let text = read(&error);
        assert!(
            text.ends_with('ä') && text.len() >= ERROR_BYTES - 2,
            "{text}"
        );
        assert_eq!(error.text[ERROR_BYTES - 1], 0);
        assert_eq!(call(None, || Err(Failure::End)), Code::End);
    }
}
