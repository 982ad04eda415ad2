//! Wraps the sending end of a transfer.
use std::{
    path::PathBuf,
    sync::{Arc, Mutex},
};

use bytes::Bytes;
use pyo3::{prelude::*, types::PyBytes, IntoPyObjectExt};
use rect_core::{
    message::encoding::Encoding,
    name::{topic::Topic, Name},
    storage::{Files, Source},
    transfer::{
        files::UsesFiles,
        offer::FileName,
        push::{self, SendError},
        Offer,
    },
};

use super::file_error;
use crate::{
    clock::Clock,
    detached::detached,
    driver::{lock, seconds, Driver, ToPython},
    errors::{raised, OrRaise},
    key_space::{name, topic, KeySpace},
};

/// An outgoing transfer.
#[pyclass(frozen, module = "rect._rect")]
pub struct TransferPush {
    recipient: Name,
    topic: Topic,
    source: Mutex<Source>,
    core: Arc<Mutex<push::TransferPush>>,
    clock: Clock,
}

/// Why a transfer was not completed; `None` if it was.
#[pyclass(frozen, module = "rect._rect")]
pub struct SendOutcome(Option<SendError>);

/// The data of a transfer: bytes, or the path of a file.
#[derive(FromPyObject)]
enum Data<'py> {
    Bytes(Bound<'py, PyBytes>),
    File(PathBuf),
}

#[pymethods]
impl TransferPush {
    /// Prepares a transfer. Reads the data once, for its checksum. `call` is a random number that identifies the call
    /// of the program. `timeout_s` is how long the receiver may be silent; `None` for no limit. Raises `FileError` if
    /// the file cannot be read, and `TransferError` if the name is not a valid file name.
    #[new]
    #[pyo3(signature = (key_space, recipient, topic, source, call, *, name=None, encoding=None, timeout_s=None))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        key_space: &KeySpace,
        recipient: &str,
        topic: &str,
        source: Data<'_>,
        call: u64,
        name: Option<String>,
        encoding: Option<String>,
        timeout_s: Option<f64>,
    ) -> PyResult<Self> {
        let (recipient, topic) = (self::name(recipient)?, self::topic(topic)?);
        let (source, file_name) = match source {
            Data::Bytes(bytes) => {
                let bytes = Bytes::copy_from_slice(bytes.as_bytes());
                (detached(py, || Source::of_bytes(bytes)), None)
            }
            Data::File(path) => {
                let source = detached(py, || Source::of_file(&path));
                let source = source.map_err(|error| file_error(py, &path, &error))?;
                let name = path.file_name();
                (source, name.map(|name| name.to_string_lossy().into_owned()))
            }
        };
        let name = name.or(file_name).unwrap_or_default();
        let offer = Offer {
            sender: key_space.0.robot.clone(),
            topic: topic.clone(),
            name: FileName::new(&name).or_raise()?,
            encoding: encoding.map_or(Encoding::BYTES, Encoding::new),
            size_bytes: source.size_bytes(),
            checksum: source.checksum(),
            call,
        };
        let (clock, timeout) = (Clock::new(), timeout_s.map(seconds));
        let now = clock.created_at();
        let core = push::TransferPush::new(&key_space.0, recipient.clone(), offer, timeout, now);
        Ok(Self {
            recipient,
            topic,
            source: Mutex::new(source),
            core: Arc::new(Mutex::new(core)),
            clock,
        })
    }

    /// Returns the driver to execute.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Reads the pieces that the driver needs. To be called before the driver is polled.
    fn perform_files(&self, py: Python<'_>) {
        loop {
            let action = lock(&self.core).poll_file();
            let Some(action) = action else { return };
            let read = detached(py, || lock(&self.source).perform(action));
            lock(&self.core).on_file(self.clock.now(), read);
        }
    }

    /// Stops the transfer.
    fn stop(&self) {
        lock(&self.core).stop();
    }

    /// Returns the exception for the outcome with which the driver has finished; `None` if the transfer is complete.
    fn error(&self, py: Python<'_>, outcome: &SendOutcome) -> Option<Py<PyAny>> {
        let Self {
            recipient, topic, ..
        } = self;
        let error = match outcome.0.as_ref()? {
            SendError::Refused(refusal) => {
                let text = format!("{recipient} refused the transfer {topic}: {refusal}");
                raised(py, "TransferRefused", (text,))
            }
            SendError::Failed(fault) => {
                let text = format!("the transfer {topic} with {recipient} failed: {fault}");
                raised(py, "TransferFailed", (text,))
            }
            SendError::TimedOut { expected, timeout } => {
                raised(py, "TimedOut", (expected, timeout.as_secs_f64()))
            }
            SendError::Closed => raised(py, "Closed", ("the transfer was stopped",)),
        };
        Some(error.into_value(py).into_any())
    }
}

#[pymethods]
impl SendOutcome {
    fn __repr__(&self) -> String {
        match &self.0 {
            None => "complete".to_owned(),
            Some(SendError::Refused(refusal)) => refusal.to_string(),
            Some(SendError::Failed(fault)) => fault.to_string(),
            Some(SendError::TimedOut { expected, timeout }) => {
                format!("no {expected} within {} s", timeout.as_secs())
            }
            Some(SendError::Closed) => "closed".to_owned(),
        }
    }
}

impl ToPython for Result<(), SendError> {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        SendOutcome(self.err()).into_py_any(py)
    }
}
