//! Wraps the receiving end of transfers: the admission of offers, and one incoming transfer.
use std::{
    collections::HashMap,
    path::PathBuf,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant, SystemTime},
};

use pyo3::{
    prelude::*,
    types::{PyBytes, PyString},
};
use rect::{
    core::topic::Pattern,
    core::transfer::{
        self,
        admission::{self, AdmissionRules, Confirmed, Decision},
        receiver::{PieceRequest, Receiver, Step},
        Fault, Offer, Request, TransferId,
    },
    storage::{Content, Store},
};

use super::{file_error, seconds_until, timeout};
use crate::{
    detached::detached,
    errors::{raised, OrRaise},
    key_space::KeySpace,
};

/// Minimum interval between two saves of the record of the stored pieces.
const SAVE_INTERVAL: Duration = Duration::from_secs(2);

/// Decides which offers a program accepts.
#[pyclass(frozen, module = "rect._rect")]
pub struct Admission(Mutex<admission::Admission>);

/// A query that asks the robot named in an offer to confirm it.
#[pyclass(frozen, module = "rect._rect")]
pub struct Question(admission::Question);

/// An offer that was accepted.
#[pyclass(frozen, module = "rect._rect")]
pub struct Offered {
    id: TransferId,
    offer: Offer,
}

/// An incoming transfer.
#[pyclass(frozen, module = "rect._rect")]
pub struct Pull(Mutex<Pulling>);

/// The state of an incoming transfer.
struct Pulling {
    offer: Offer,
    core: Receiver,
    store: Option<Store>,
    /// The requests that have no reply yet, by their id.
    requests: HashMap<u64, PieceRequest>,
    /// The time of the last save, and the number of bytes that were stored then.
    saved: (Instant, u64),
    result: Option<Result<Content, Fault>>,
}

/// The transfer that begins, or the id of a transfer that continues.
type Accepted = (Option<Offered>, Option<String>);

/// The next step: `request` (id, payload and timeout in seconds), `wait` (time in seconds) or `finished`.
type NextStep<'py> = (&'static str, u64, Option<Bound<'py, PyBytes>>, f64);

#[pymethods]
impl Admission {
    /// Creates the admission for a pattern. `folder` is where transfers are stored; `None` for memory. Creates the
    /// folder, and removes outdated parts of interrupted transfers from it. Raises `FileError`.
    #[new]
    fn new(
        py: Python<'_>,
        key_space: &KeySpace,
        pattern: &str,
        max_bytes: u64,
        max_concurrent: usize,
        folder: Option<PathBuf>,
    ) -> PyResult<Self> {
        let pattern = Pattern::new(pattern).or_raise()?;
        if let Some(folder) = folder {
            let made = detached(py, || {
                std::fs::create_dir_all(&folder)?;
                Store::clean(&folder, SystemTime::now());
                Ok(())
            });
            made.map_err(|error| file_error(py, &folder, &error))?;
        }
        let rules = AdmissionRules {
            pattern,
            max_bytes,
            max_concurrent: max_concurrent.max(1),
        };
        let admission = admission::Admission::new(key_space.0.robot.clone(), rules);
        Ok(Self(Mutex::new(admission)))
    }

    /// Handles an offer. Returns the answer, and, if the transfer is already in progress, its id.
    fn on_offer<'py>(
        &self,
        py: Python<'py>,
        offer: &[u8],
    ) -> (Bound<'py, PyBytes>, Option<String>) {
        let decision = lock(&self.0).on_offer(Instant::now(), offer);
        let (answer, running) = match decision {
            Decision::Answer(answer) => (answer, None),
            Decision::Running(id, answer) => (answer, Some(id.to_string())),
        };
        (PyBytes::new(py, &answer.encode()), running)
    }

    /// Returns the next question. If there is none, returns the time to wait in seconds (`None` means until the next
    /// event).
    fn poll(&self) -> (Option<Question>, Option<f64>) {
        match lock(&self.0).poll(Instant::now()) {
            admission::Step::Ask(question) => (Some(Question(question)), None),
            admission::Step::Wait(until) => (None, until.map(seconds_until)),
        }
    }

    /// Handles the reply to a question. Returns the transfer that begins, or the id of one that continues.
    fn on_confirmed(&self, question: &Question, reply: &[u8]) -> Accepted {
        match lock(&self.0).on_confirmed(&question.0, reply) {
            None => (None, None),
            Some(Confirmed::Running(id)) => (None, Some(id.to_string())),
            Some(Confirmed::Accept(id, offer)) => {
                let offer = *offer;
                (Some(Offered { id, offer }), None)
            }
        }
    }

    /// Handles the end of the replies to a question.
    fn on_no_reply(&self, question: &Question) {
        lock(&self.0).on_no_reply(Instant::now(), &question.0);
    }

    /// Handles an accepted transfer that does not begin, because the program has stopped receiving transfers.
    fn on_stopped(&self, offered: &Offered) {
        lock(&self.0).on_ended(offered.id, &Err(Fault::Stopped));
    }

    /// Handles progress: `received_bytes` bytes of the transfer are stored.
    fn on_received_bytes(&self, offered: &Offered, received_bytes: u64) {
        lock(&self.0).on_received_bytes(offered.id, received_bytes);
    }

    /// Handles the end of a transfer. `delivered` is whether the program receives the result.
    fn on_ended(&self, offered: &Offered, pull: &Pull, delivered: bool) {
        let result = match &lock(&pull.0).result {
            Some(Ok(_)) if delivered => Ok(()),
            Some(Err(fault)) if delivered => Err(fault.clone()),
            _ => Err(Fault::Stopped),
        };
        lock(&self.0).on_ended(offered.id, &result);
    }
}

#[pymethods]
impl Question {
    /// The robot to query.
    #[getter]
    fn robot(&self) -> &str {
        self.0.sender.as_str()
    }

    /// The key to query: the part after that robot's `@rect/`.
    #[getter]
    fn key(&self) -> String {
        transfer::source(self.0.id)
    }

    /// The timeout of the query, in seconds.
    #[getter]
    fn timeout(&self) -> f64 {
        self.0.timeout.as_secs_f64()
    }

    /// The payload of the query.
    #[getter]
    fn payload<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &Request::Confirm.encode())
    }
}

#[pymethods]
impl Offered {
    #[getter]
    fn id(&self) -> String {
        self.id.to_string()
    }

    #[getter]
    fn sender(&self) -> &str {
        self.offer.sender.as_str()
    }

    #[getter]
    fn topic(&self) -> &str {
        self.offer.topic.as_str()
    }

    #[getter]
    fn name(&self) -> &str {
        self.offer.name.as_str()
    }

    #[getter]
    fn encoding(&self) -> &str {
        self.offer.encoding.as_str()
    }

    #[getter]
    fn size_bytes(&self) -> u64 {
        self.offer.size_bytes
    }

    /// The key of the pieces: the part after the sender's `@rect/`.
    #[getter]
    fn key(&self) -> String {
        transfer::source(self.id)
    }
}

#[pymethods]
impl Pull {
    /// Begins a transfer, or continues one that a restart interrupted. `folder` is where it is stored; `None` for
    /// memory. `timeout_s` is how long nothing may arrive before the transfer fails.
    #[new]
    fn new(
        py: Python<'_>,
        offered: &Offered,
        folder: Option<PathBuf>,
        timeout_s: f64,
    ) -> PyResult<Self> {
        let timeout = timeout(py, timeout_s)?;
        let offer = offered.offer.clone();
        let opened = detached(py, || match folder {
            None => Store::in_memory(offer.size_bytes).map(|store| (store, Default::default())),
            Some(folder) => Store::in_folder(&folder, offered.id, &offer),
        });
        let (store, held, result) = match opened {
            Ok((store, held)) => (Some(store), held, None),
            Err(error) => {
                let fault = Fault::NotStored(error.to_string());
                (None, Default::default(), Some(Err(fault)))
            }
        };
        let now = Instant::now();
        let core = Receiver::new(now, offer.size_bytes, held, timeout);
        let saved = (now, core.progress().received_bytes);
        Ok(Self(Mutex::new(Pulling {
            offer,
            core,
            store,
            requests: HashMap::new(),
            saved,
            result,
        })))
    }

    /// Returns the next step. After the last piece, this call computes the checksum.
    fn poll<'py>(&self, py: Python<'py>) -> NextStep<'py> {
        match detached(py, || lock(&self.0).poll()) {
            Step::Request(piece) => {
                let payload = PyBytes::new(py, &piece.request.encode());
                let timeout = piece.timeout.as_secs_f64();
                ("request", piece.id, Some(payload), timeout)
            }
            Step::Wait(until) => ("wait", 0, None, seconds_until(until)),
            Step::Check | Step::Finished(_) => ("finished", 0, None, 0.0),
        }
    }

    /// Handles the reply to a request.
    fn on_reply(&self, py: Python<'_>, id: u64, bytes: &[u8]) {
        detached(py, || lock(&self.0).on_reply(id, bytes));
    }

    /// Handles an error reply. Errors of Zenoh itself, such as a timeout, are not from the sender and are ignored.
    fn on_error(&self, id: u64, bytes: &[u8]) {
        if let Some(fault) = Fault::decode(bytes) {
            lock(&self.0).core.on_fault(id, fault);
        }
    }

    /// Handles the end of the replies to a request.
    fn on_end(&self, id: u64) {
        let mut pulling = lock(&self.0);
        pulling.requests.remove(&id);
        pulling.core.on_no_reply(Instant::now(), id);
    }

    /// Handles a repeated offer of the sender.
    fn on_offered(&self) {
        lock(&self.0).core.on_offered(Instant::now());
    }

    /// Stops the transfer on behalf of the program.
    fn stop(&self) {
        lock(&self.0).core.end(Fault::Stopped);
    }

    /// Returns the number of stored bytes, and the size of the transfer in bytes.
    fn progress(&self) -> (u64, u64) {
        let progress = lock(&self.0).core.progress();
        (progress.received_bytes, progress.size_bytes)
    }

    /// Whether the program stopped the transfer.
    #[getter]
    fn is_stopped(&self) -> bool {
        matches!(lock(&self.0).result, Some(Err(Fault::Stopped)))
    }

    /// Returns the content once the transfer has ended: bytes, or the path of a file. Raises `TransferFailed`.
    fn content<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let pulling = lock(&self.0);
        match &pulling.result {
            Some(Ok(Content::Bytes(bytes))) => Ok(PyBytes::new(py, bytes).into_any()),
            Some(Ok(Content::File(path))) => {
                Ok(PyString::new(py, &path.to_string_lossy()).into_any())
            }
            Some(Err(fault)) => {
                let Offer { sender, topic, .. } = &pulling.offer;
                let text = format!("the transfer {topic} with {sender} failed: {fault}");
                Err(raised(py, "TransferFailed", (text,)))
            }
            None => Err(raised(
                py,
                "TransferFailed",
                ("the transfer has not ended",),
            )),
        }
    }
}

impl Pulling {
    fn poll(&mut self) -> Step {
        if self.result.is_some() {
            return Step::Finished(Ok(()));
        }
        self.save_if_due();
        loop {
            match self.core.poll(Instant::now()) {
                Step::Request(piece) => {
                    self.requests.insert(piece.id, piece.clone());
                    return Step::Request(piece);
                }
                Step::Wait(until) => return Step::Wait(until),
                Step::Check => self.check(),
                Step::Finished(result) => {
                    self.result = Some(self.finish(result));
                    return Step::Finished(Ok(()));
                }
            }
        }
    }

    fn on_reply(&mut self, id: u64, bytes: &[u8]) {
        // Only one reply per request counts: more would fill the memory.
        let (Some(piece), Some(store)) = (self.requests.remove(&id), self.store.as_mut()) else {
            return;
        };
        if !self
            .core
            .on_reply(Instant::now(), &piece, bytes.len() as u64)
        {
            return;
        }
        match store.write(piece.range.start, bytes) {
            Ok(()) => self.core.on_written(piece.range),
            Err(error) => self.core.on_write_failed(error.to_string()),
        }
    }

    fn check(&mut self) {
        let Some(store) = self.store.as_mut() else {
            return self.core.end(Fault::Stopped);
        };
        match store.checksum() {
            Ok(checksum) => self.core.on_checked(checksum == self.offer.checksum),
            Err(error) => self.core.on_write_failed(error.to_string()),
        }
    }

    fn save_if_due(&mut self) {
        let (saved_at, saved_bytes) = self.saved;
        let received_bytes = self.core.progress().received_bytes;
        if received_bytes == saved_bytes || saved_at.elapsed() < SAVE_INTERVAL {
            return;
        }
        if let Some(Err(error)) = self
            .store
            .as_ref()
            .map(|store| store.save(self.core.held()))
        {
            self.core.on_write_failed(error.to_string());
        }
        self.saved = (Instant::now(), received_bytes);
    }

    fn finish(&mut self, result: Result<(), Fault>) -> Result<Content, Fault> {
        let store = self.store.take().ok_or(Fault::Stopped)?;
        match result {
            Ok(()) => store
                .finish()
                .map_err(|error| Fault::NotStored(error.to_string())),
            Err(fault) => {
                // Pieces that are not saved are sent again. The reason for the end is more important.
                let _ = store.interrupt(self.core.held(), &fault);
                Err(fault)
            }
        }
    }
}

/// Encodes the request that informs the sender of the end of a transfer.
#[pyfunction]
pub fn transfer_ended(py: Python<'_>) -> Bound<'_, PyBytes> {
    PyBytes::new(py, &Request::Ended.encode())
}

fn lock<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}
