//! Wraps the sending end of a transfer.
use std::{
    path::PathBuf,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use bytes::Bytes;
use pyo3::{prelude::*, types::PyBytes};
use rect::{
    core::{
        encoding::Encoding,
        name::Name,
        topic::Topic,
        transfer::{
            self,
            offer::FileName,
            sender::{Outcome, Response, Sender, Step},
            Answer, Offer, Request,
        },
    },
    storage::Source,
};

use super::{file_error, seconds_until, timeout};
use crate::{
    detached::detached,
    errors::{raised, OrRaise},
    key_space::{name, topic, KeySpace},
};

/// An outgoing transfer.
#[pyclass(frozen, module = "rect._rect")]
pub struct TransferSender {
    recipient: Name,
    topic: Topic,
    offer: Offer,
    source: Source,
    core: Mutex<Sender>,
}

/// The data of a transfer: bytes, or the path of a file.
#[derive(FromPyObject)]
enum Data<'py> {
    Bytes(Bound<'py, PyBytes>),
    File(PathBuf),
}

#[pymethods]
impl TransferSender {
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
        let timeout = timeout_s.map(|seconds| timeout(py, seconds)).transpose()?;
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
        let now = Instant::now();
        let core = Mutex::new(Sender::new(now, offer.size_bytes, timeout, call));
        Ok(Self {
            recipient,
            topic,
            offer,
            source,
            core,
        })
    }

    /// The key at which this robot serves the pieces: the part after `@rect/`.
    #[getter]
    fn key(&self) -> String {
        transfer::source(self.offer.id(&self.recipient))
    }

    /// The encoded offer.
    #[getter]
    fn offer<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.offer.encode())
    }

    /// Returns the next step: `offer` (with the timeout of the offer in seconds), `wait` (with the time to wait in
    /// seconds) or `done`. Raises `TransferRefused`, `TransferFailed` and `TimedOut`.
    fn poll(&self, py: Python<'_>) -> PyResult<(&'static str, f64)> {
        let step = self.core().poll(Instant::now());
        match step {
            Step::Offer(timeout) => Ok(("offer", timeout.as_secs_f64())),
            Step::Wait(until) => Ok(("wait", seconds_until(until))),
            Step::Finished(Outcome::Done) => Ok(("done", 0.0)),
            Step::Finished(outcome) => Err(self.error(py, outcome)),
        }
    }

    /// Handles the answers of the receiver's programs to an offer.
    fn on_answers(&self, answers: Vec<Vec<u8>>) {
        let answers = answers.iter().filter_map(|bytes| Answer::decode(bytes));
        let answers: Vec<_> = answers.collect();
        self.core().on_answers(Instant::now(), &answers);
    }

    /// Handles a request of the receiver. Returns `(True, reply, 0)`, or `(False, error, 0)` for an error reply.
    /// Returns `(True, None, number)` if the query must stay open until the offer with that number has been answered.
    /// Returns `None` if the request is invalid.
    fn on_request<'py>(
        &self,
        py: Python<'py>,
        request: &[u8],
    ) -> Option<(bool, Option<Bound<'py, PyBytes>>, u64)> {
        let request = Request::decode(request)?;
        let response = self.core().on_request(Instant::now(), &request);
        let reply = match response {
            Ok(Response::AfterOffer(number)) => return Some((true, None, number)),
            Ok(Response::Offer) => return Some((true, Some(self.offer(py)), 0)),
            Ok(Response::Piece(range)) => {
                detached(py, || self.source.read(range)).inspect_err(|fault| {
                    self.core().on_fault(fault.clone());
                })
            }
            Err(fault) => Err(fault),
        };
        Some(match reply {
            Ok(bytes) => (true, Some(PyBytes::new(py, &bytes)), 0),
            Err(fault) => (false, Some(PyBytes::new(py, &fault.encode())), 0),
        })
    }

    /// Returns the number of bytes that the receiver has stored, and the size of the transfer in bytes.
    fn progress(&self) -> (u64, u64) {
        let progress = self.core().progress();
        (progress.received_bytes, progress.size_bytes)
    }
}

impl TransferSender {
    fn core(&self) -> MutexGuard<'_, Sender> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn error(&self, py: Python<'_>, outcome: Outcome) -> PyErr {
        let Self {
            recipient, topic, ..
        } = self;
        match outcome {
            Outcome::Refused(refusal) => {
                let text = format!("{recipient} refused the transfer {topic}: {refusal}");
                raised(py, "TransferRefused", (text,))
            }
            Outcome::Failed(fault) => {
                let text = format!("the transfer {topic} with {recipient} failed: {fault}");
                raised(py, "TransferFailed", (text,))
            }
            Outcome::NoAnswer(after) => {
                let expected = format!("reply of {recipient} about the transfer {topic}");
                raised(py, "TimedOut", (expected, after.as_secs_f64()))
            }
            Outcome::Done => raised(py, "TimedOut", ("end", Duration::ZERO.as_secs_f64())),
        }
    }
}
