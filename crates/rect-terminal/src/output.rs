//! Writes to the standard output and to stderr without panics. If the reader of the standard output has exited, the program
//! exits without a message.
use std::{
    fmt,
    io::{self, ErrorKind, Write},
    process,
};

use rect_core::text::display;
use serde::Serialize;

/// The exit status after the reader of the standard output has exited: that of a program that SIGPIPE has ended.
pub const CLOSED_PIPE: u8 = 141;

/// Writes a line to the standard output. If the reader has exited, the program exits with the status
/// [`CLOSED_PIPE`](crate::CLOSED_PIPE). After any other error, it prints a message to stderr and exits with
/// the status 1.
#[macro_export]
macro_rules! outln {
    ($($arguments:tt)*) => { $crate::write_out(format_args!($($arguments)*)) };
}

/// Writes a line to stderr. Errors are ignored, since there is no other place to report them.
#[macro_export]
macro_rules! errln {
    ($($arguments:tt)*) => { $crate::write_err(format_args!($($arguments)*)) };
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
/// Returns the error of the operating system, for example if the standard output is closed or the disk is full.
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

/// Writes a value to the standard output as indented JSON, as [`outln!`](crate::outln) does.
///
/// # Errors
/// Returns the error if the value cannot be serialized as JSON.
pub fn json(value: &impl Serialize) -> serde_json::Result<()> {
    write_out(format_args!(
        "{}",
        display::json(&serde_json::to_string_pretty(value)?)
    ));
    Ok(())
}

/// Writes a value to the standard output as one line of JSON, as [`outln!`](crate::outln) does.
///
/// # Errors
/// Returns the error if the value cannot be serialized as JSON.
pub fn json_line(value: &impl Serialize) -> serde_json::Result<()> {
    write_out(format_args!(
        "{}",
        display::json(&serde_json::to_string(value)?)
    ));
    Ok(())
}
