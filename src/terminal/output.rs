//! Writes to the standard output and to stderr without panics. A reader that is gone ends the program quietly.
use std::{
    fmt,
    io::{self, ErrorKind, Write},
    process,
};

use serde::Serialize;

use crate::core::display;

/// The exit status when the reader of the standard output is gone: that of a program that SIGPIPE ended.
pub const CLOSED_PIPE: u8 = 141;

/// Writes a line to the standard output. Ends the program with [`CLOSED_PIPE`] if nobody reads it any more, and with 1 and
/// a message if it cannot be written for another reason.
#[macro_export]
macro_rules! outln {
    ($($arguments:tt)*) => { $crate::terminal::write_out(format_args!($($arguments)*)) };
}

/// Writes a line to stderr. What cannot be written is lost: there is no other place to report it.
#[macro_export]
macro_rules! errln {
    ($($arguments:tt)*) => { $crate::terminal::write_err(format_args!($($arguments)*)) };
}

/// Writes a line to the standard output, as [`outln!`](crate::outln) does.
pub fn write_out(line: fmt::Arguments<'_>) {
    let Err(error) = try_write(line) else { return };
    if error.kind() == ErrorKind::BrokenPipe {
        process::exit(i32::from(CLOSED_PIPE));
    }
    write_err(format_args!("cannot write to the standard output: {error}"));
    process::exit(1);
}

/// Writes a line to the standard output.
///
/// # Errors
/// The standard output is closed, or full.
pub fn try_write(line: fmt::Arguments<'_>) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_fmt(line)?;
    out.write_all(b"\n")?;
    out.flush()
}

/// Writes a line to stderr, as [`errln!`](crate::errln) does.
pub fn write_err(line: fmt::Arguments<'_>) {
    let text = format!("{line}\n");
    let _ = io::stderr().lock().write_all(text.as_bytes());
}

/// Writes a value as JSON of several lines to the standard output.
///
/// # Errors
/// The value has no JSON.
pub fn json(value: &impl Serialize) -> serde_json::Result<()> {
    write_out(format_args!(
        "{}",
        display::json(&serde_json::to_string_pretty(value)?)
    ));
    Ok(())
}

/// Writes a value as one line of JSON to the standard output.
///
/// # Errors
/// The value has no JSON.
pub fn json_line(value: &impl Serialize) -> serde_json::Result<()> {
    write_out(format_args!(
        "{}",
        display::json(&serde_json::to_string(value)?)
    ));
    Ok(())
}
