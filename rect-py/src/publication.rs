//! Numbers the messages that a program publishes.
use std::{
    sync::Mutex,
    time::{Duration, SystemTime},
};

use pyo3::{prelude::*, types::PyBytes};
use rect_core::{clock::unix::ms_since_1970, message::attachment::Sent, session::publication};

use crate::driver::lock;

/// Numbers the messages of one publisher.
#[pyclass(frozen, module = "rect._rect")]
pub struct Numbering(Mutex<publication::Numbering>);

#[pymethods]
impl Numbering {
    /// Begins with the number 0. `source` is a random number of 16 bits that identifies the publisher.
    #[new]
    fn new(source: u16) -> Self {
        Self(Mutex::new(publication::Numbering::new(source)))
    }

    /// Returns the attachment of a message that is sent now. `lifetime`: the time in seconds after which it expires.
    #[pyo3(signature = (lifetime=None))]
    fn attachment<'py>(&self, py: Python<'py>, lifetime: Option<f64>) -> Bound<'py, PyBytes> {
        let lifetime = lifetime.map(|s| Duration::try_from_secs_f64(s).unwrap_or(Duration::MAX));
        PyBytes::new(
            py,
            &lock(&self.0).attachment(Sent::At(ms_since_1970(SystemTime::now())), lifetime),
        )
    }

    /// Handles that the message was sent.
    fn on_sent(&self) {
        lock(&self.0).on_sent();
    }
}
