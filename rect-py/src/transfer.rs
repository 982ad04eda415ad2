//! Wraps the sending and receiving ends of transfers: the core's state machines with the library's storage.
mod pull;
mod sender;

pub use pull::{transfer_ended, Admission, Offered, Pull, Question};
pub use sender::TransferSender;

use std::{
    path::Path,
    time::{Duration, Instant},
};

use pyo3::prelude::*;

use crate::errors::raised;

/// Returns the time until `time`, in seconds; 0 if it has passed.
fn seconds_until(time: Instant) -> f64 {
    time.saturating_duration_since(Instant::now()).as_secs_f64()
}

/// Converts a timeout that the program passes. Raises `OptionError` if it is negative or not a number.
fn timeout(py: Python<'_>, seconds: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(seconds).map_err(|_| {
        let expected = "it must be a number of seconds that is not negative";
        raised(
            py,
            "OptionError",
            ("timeout", seconds.to_string(), expected),
        )
    })
}

/// Makes a `FileError`.
fn file_error(py: Python<'_>, path: &Path, error: &std::io::Error) -> PyErr {
    let text = format!("{}: {error}", path.display());
    raised(py, "FileError", (text, error.raw_os_error()))
}
