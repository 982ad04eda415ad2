//! Guards the boundary to C: stops panics and turns a failure into a result code and an error text.
use std::{
    any::Any,
    cell::RefCell,
    ffi::c_char,
    mem::MaybeUninit,
    panic::{catch_unwind, AssertUnwindSafe},
};

use rect_core::text::humanize;

use crate::failure::{Code, Failure};

/// Size of the text of an error, including the terminating zero byte.
pub const ERROR_BYTES: usize = 1024;

/// The reason why a call failed.
///
/// Almost every function that can fail takes a pointer to one, which may be NULL. The function writes to it if the call fails
/// and leaves it unchanged otherwise. It owns no memory and is not dropped. `rect_error_cause` returns the causes.
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

thread_local! {
    /// The failure of this thread's last call that failed, if it has causes. They become text only if the program asks for
    /// them.
    static LAST_FAILURE: RefCell<Option<Failure>> = const { RefCell::new(None) };
}

/// Writes a cause of the error that a call has returned to `text`: one line of UTF-8 with a terminating zero byte. `index` is
/// 0 for the direct cause, 1 for the cause of that one, and so on. The text of the error already contains what matters of
/// them; they help to find out why Zenoh or the operating system refused something.
///
/// The error is that of the calling thread's last call that failed. This function does not replace it.
///
/// ```c
/// char cause[RECT_ERROR_BYTES];
/// for (size_t n = 0; rect_error_cause(n, &cause) == RECT_CODE_OK; ++n) {
///     printf("  caused by: %s\n", cause);
/// }
/// ```
///
/// Returns `RECT_CODE_END` if there are no more causes, and `RECT_CODE_ARGUMENT` if `text` is NULL. May be called on any
/// thread.
#[no_mangle]
pub extern "C" fn rect_error_cause(
    index: usize,
    text: Option<&mut MaybeUninit<[c_char; ERROR_BYTES]>>,
) -> Code {
    let written = guarded(|| {
        require_out("text", &text)?;
        let cause = LAST_FAILURE.with_borrow(|last| {
            let error = last.as_ref()?.with_causes()?;
            humanize::causes(error).nth(index)
        });
        write_out("text", text, buffer(&cause.ok_or(Failure::End)?))
    });
    written.map_or_else(|failure| failure.code(), |()| Code::Ok)
}

/// Runs the body of an entry point, and converts its failure or panic into a code and an error text.
pub fn call(reason: Reason<'_>, body: impl FnOnce() -> Result<(), Failure>) -> Code {
    let Err(failure) = guarded(body) else {
        return Code::Ok;
    };
    let code = failure.code();
    if let Some(reason) = reason {
        let text = buffer(&failure.text());
        reason.write(ErrorOut { code, text });
    }
    // Fails only while the thread ends, when nobody can ask for the causes.
    let last = failure.with_causes().is_some().then_some(failure);
    let _ = LAST_FAILURE.try_with(|kept| kept.replace(last));
    code
}

fn guarded(body: impl FnOnce() -> Result<(), Failure>) -> Result<(), Failure> {
    // After a panic, every object is still consistent: it is protected by a lock that ignores poisoning, or it is dropped.
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(done) => done,
        Err(panic) => Err(Failure::Internal(panic_message(&*panic))),
    }
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
    fn causes_are_those_of_the_last_failure_of_the_thread() {
        let mut text = MaybeUninit::uninit();
        let failed = || {
            let path = "/maps".into();
            let reason = std::io::Error::other("the disk is full");
            Err(Failure::Rect(rect::Error::File { path, reason }))
        };
        assert_eq!(call(None, failed), Code::File);
        for (index, code) in [(0, Code::Ok), (1, Code::End), (0, Code::Ok)] {
            assert_eq!(rect_error_cause(index, Some(&mut text)), code);
        }
        // SAFETY: the last call succeeded, so it has written the text.
        let text = unsafe { text.assume_init() };
        let code = Code::File;
        assert_eq!(read(&ErrorOut { code, text }), "the disk is full");
        assert_eq!(call(None, || Ok(())), Code::Ok);
        assert_eq!(rect_error_cause(1, None), Code::Argument);
        let mut text = MaybeUninit::uninit();
        let other = std::thread::spawn(|| rect_error_cause(0, Some(&mut MaybeUninit::uninit())));
        assert_eq!(other.join().expect("no panic"), Code::End);
        assert_eq!(rect_error_cause(0, Some(&mut text)), Code::Ok);
        assert_eq!(call(None, || Err(Failure::Closed)), Code::Closed);
        assert_eq!(rect_error_cause(0, Some(&mut text)), Code::End);
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
