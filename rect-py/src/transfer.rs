//! Owns the two ends of a transfer: the core's machines, with the library's files beside them.
mod pull;
mod sender;

pub use pull::{transfer_ended, Inbox, Offered, Pull, Question};
pub use sender::TransferSender;

use std::{
    path::Path,
    time::{Duration, Instant},
};

use pyo3::prelude::*;

use crate::errors::raised;

/// How long until then, in seconds.
fn seconds_until(then: Instant) -> f64 {
    then.saturating_duration_since(Instant::now()).as_secs_f64()
}

/// A length of time that a program gave.
fn patience(py: Python<'_>, seconds: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(seconds).map_err(|_| {
        let known = "it is a number of seconds, not below 0";
        raised(py, "OptionError", ("patience", seconds.to_string(), known))
    })
}

fn file_error(py: Python<'_>, path: &Path, error: &std::io::Error) -> PyErr {
    let text = format!("{}: {error}", path.display());
    raised(py, "FileError", (text, error.raw_os_error()))
}
