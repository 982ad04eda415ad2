//! Owns the sending end of a transfer.
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

use super::{file_error, patience, seconds_until};
use crate::{
    detached::detached,
    errors::{raised, OrRaise},
    place::{name, topic, Place},
};

/// A transfer that is sent.
#[pyclass(frozen, module = "rect._rect")]
pub struct TransferSender {
    to: Name,
    topic: Topic,
    offer: Offer,
    source: Source,
    core: Mutex<Sender>,
}

/// What is sent.
#[derive(FromPyObject)]
enum Given<'py> {
    Bytes(Bound<'py, PyBytes>),
    File(PathBuf),
}

#[pymethods]
impl TransferSender {
    /// Reads the source once, for its checksum.
    #[new]
    #[pyo3(signature = (place, to, topic, source, call, *, name=None, encoding=None, patience_s=None))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        place: &Place,
        to: &str,
        topic: &str,
        source: Given<'_>,
        call: u64,
        name: Option<String>,
        encoding: Option<String>,
        patience_s: Option<f64>,
    ) -> PyResult<Self> {
        let (to, topic) = (self::name(to)?, self::topic(topic)?);
        let patience = patience_s
            .map(|seconds| patience(py, seconds))
            .transpose()?;
        let (source, given_name) = match source {
            Given::Bytes(bytes) => {
                let bytes = Bytes::copy_from_slice(bytes.as_bytes());
                (detached(py, || Source::of_bytes(bytes)), None)
            }
            Given::File(path) => {
                let source = detached(py, || Source::of_file(&path));
                let source = source.map_err(|error| file_error(py, &path, &error))?;
                let name = path.file_name();
                (source, name.map(|name| name.to_string_lossy().into_owned()))
            }
        };
        let name = name.or(given_name).unwrap_or_default();
        let offer = Offer {
            from: place.0.robot.clone(),
            topic: topic.clone(),
            name: FileName::new(&name).or_raise()?,
            encoding: encoding.map_or(Encoding::BYTES, Encoding::new),
            size_bytes: source.size_bytes(),
            checksum: source.checksum(),
            call,
        };
        let now = Instant::now();
        let core = Mutex::new(Sender::new(now, offer.size_bytes, patience, call));
        Ok(Self {
            to,
            topic,
            offer,
            source,
            core,
        })
    }

    /// What goes after this robot's `@rect/` for its pieces.
    #[getter]
    fn key(&self) -> String {
        transfer::source(self.offer.id(&self.to))
    }

    /// What to offer.
    #[getter]
    fn offer<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.offer.encode())
    }

    /// What to do: `offer` it, for so many seconds; `wait` so long; or it is `done`. Raises why it is not.
    fn poll(&self, py: Python<'_>) -> PyResult<(&'static str, f64)> {
        let step = self.core().poll(Instant::now());
        match step {
            Step::Offer(timeout) => Ok(("offer", timeout.as_secs_f64())),
            Step::Wait(until) => Ok(("wait", seconds_until(until))),
            Step::Over(Outcome::Done) => Ok(("done", 0.0)),
            Step::Over(outcome) => Err(self.error(py, outcome)),
        }
    }

    /// What programs of the receiver answered to an offer.
    fn on_answers(&self, answers: Vec<Vec<u8>>) {
        let answers = answers.iter().filter_map(|bytes| Answer::decode(bytes));
        let answers: Vec<_> = answers.collect();
        self.core().on_answers(Instant::now(), &answers);
    }

    /// Handles a request: the reply (`True`), or what is wrong (`False`), or the number of the offer until whose answers the
    /// query stays open; `None`: it is no request.
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

    /// How many bytes the receiver holds, of how many.
    fn progress(&self) -> (u64, u64) {
        let progress = self.core().progress();
        (progress.held_bytes, progress.size_bytes)
    }
}

impl TransferSender {
    fn core(&self) -> MutexGuard<'_, Sender> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn error(&self, py: Python<'_>, outcome: Outcome) -> PyErr {
        let Self { to, topic, .. } = self;
        match outcome {
            Outcome::Refused(refusal) => {
                let text = format!("{to} does not take the transfer {topic}: {refusal}");
                raised(py, "TransferRefused", (text,))
            }
            Outcome::Failed(fault) => {
                let text = format!("the transfer {topic} with {to} did not get there: {fault}");
                raised(py, "TransferFailed", (text,))
            }
            Outcome::Unanswered(after) => {
                let what = format!("word of {to} about the transfer {topic}");
                raised(py, "TimedOut", (what, after.as_secs_f64()))
            }
            Outcome::Done => raised(py, "TimedOut", ("end", Duration::ZERO.as_secs_f64())),
        }
    }
}
