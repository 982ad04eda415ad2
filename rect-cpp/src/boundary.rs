//! Guards the boundary to C: stops panics and turns a failure into a result code and an error text.
use std::{
    any::Any,
    ffi::c_char,
    mem::MaybeUninit,
    panic::{catch_unwind, AssertUnwindSafe},
};

use crate::failure::{Code, Failure};

/// Size of the text of an error, including the terminating zero byte.
pub const ERROR_BYTES: usize = 1024;

/// The reason why a call failed.
///
/// Every function that can fail takes a pointer to one, which may be NULL. The function writes to it if the call fails and
/// leaves it unchanged otherwise. It owns no memory and is not dropped.
#[repr(C)]
pub struct ErrorOut {
    /// The code that the call also returned.
    pub code: Code,
    /// A description for people: one line of UTF-8 with a terminating zero byte. Longer texts are truncated.
    pub text: [c_char; ERROR_BYTES],
}

/// The caller's `rect_error`; `None` if it passed NULL.
pub type Reason<'a> = Option<&'a mut MaybeUninit<ErrorOut>>;

/// The caller's variable for a result; `None` if it passed NULL.
pub type Out<'a, T> = Option<&'a mut MaybeUninit<T>>;

/// Runs the body of an entry point, and converts its failure or panic into a code and an error text.
pub fn call(reason: Reason<'_>, body: impl FnOnce() -> Result<(), Failure>) -> Code {
    // After a panic, every object is still consistent: it is protected by a lock that ignores poisoning, or it is dropped.
    let failure = match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => return Code::Ok,
        Ok(Err(failure)) => failure,
        Err(panic) => Failure::Internal(panic_message(&*panic)),
    };
    let code = failure.code();
    if let Some(reason) = reason {
        let text = buffer(&failure.text());
        reason.write(ErrorOut { code, text });
    }
    code
}

/// Writes the result of a call to the caller's variable.
pub fn write_out<T>(name: &'static str, out: Out<'_, T>, value: T) -> Result<(), Failure> {
    require_out(name, &out)?;
    if let Some(out) = out {
        out.write(value);
    }
    Ok(())
}

/// Checks that there is a variable for the result. Must be called before anything that cannot be undone.
pub fn require_out<T>(name: &'static str, out: &Out<'_, T>) -> Result<(), Failure> {
    let is_null = out.is_none();
    is_null
        .then(|| Failure::argument(name, "is NULL; it must point to a variable for the result"))
        .map_or(Ok(()), Err)
}

fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without text").to_owned()
}

/// Copies as much of a text as fits, ending at a character boundary, and terminates it with a zero byte.
pub fn buffer<const BYTES: usize>(text: &str) -> [c_char; BYTES] {
    let mut buffer = [0; BYTES];
    let end = (0..BYTES.min(text.len() + 1))
        .rev()
        .find(|&end| text.is_char_boundary(end));
    let copied = text.get(..end.unwrap_or(0)).unwrap_or_default();
    for (to, byte) in buffer.iter_mut().zip(copied.bytes()) {
        // A zero byte would end the text early.
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
    fn panic_becomes_an_internal_error() {
        let mut reason = MaybeUninit::uninit();
        let code = call(Some(&mut reason), || panic!("in row {}", 7));
        assert_eq!(code, Code::Internal);
        // SAFETY: the call failed, so `call` has written the error.
        let error = unsafe { reason.assume_init() };
        assert!(read(&error).ends_with("in row 7"), "{}", read(&error));
    }

    #[test]
    fn long_error_text_is_truncated_at_a_character_boundary() {
        let long = format!("a{}", "ä".repeat(ERROR_BYTES));
        let mut reason = MaybeUninit::uninit();
        call(Some(&mut reason), || Err(Failure::argument("x", long)));
        // SAFETY: the call failed, so `call` has written the error.
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
