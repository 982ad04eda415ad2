//! Owns the receiving end of transfers: which offers are taken, and one that comes.
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
        inbox::{self, Confirmed, Decision, Wanted},
        receiver::{Ask, Receiver, Step},
        Fault, Offer, Request, TransferId,
    },
    storage::{Content, Store},
};

use super::{file_error, patience, seconds_until};
use crate::{
    detached::detached,
    errors::{raised, OrRaise},
    place::Place,
};

/// How often what is there is written down.
const SAVE_EVERY: Duration = Duration::from_secs(2);

/// The offers to one program's wish.
#[pyclass(frozen, module = "rect._rect")]
pub struct Inbox(Mutex<inbox::Inbox>);

/// A question to the robot that an offer names.
#[pyclass(frozen, module = "rect._rect")]
pub struct Question(inbox::Question);

/// A transfer that was offered, and is taken.
#[pyclass(frozen, module = "rect._rect")]
pub struct Offered {
    id: TransferId,
    offer: Offer,
}

/// A transfer that comes.
#[pyclass(frozen, module = "rect._rect")]
pub struct Pull(Mutex<Pulling>);

struct Pulling {
    offer: Offer,
    core: Receiver,
    store: Option<Store>,
    asks: HashMap<u64, Ask>,
    saved: (Instant, u64),
    how: Option<Result<Content, Fault>>,
}

/// The transfer that begins, or the id of one that goes on.
type Taken = (Option<Offered>, Option<String>);

/// `ask` (ticket, payload, time-out in seconds), `wait` (seconds), or `over`.
type Next<'py> = (&'static str, u64, Option<Bound<'py, PyBytes>>, f64);

#[pymethods]
impl Inbox {
    /// `folder`: where files are kept, if they are.
    #[new]
    fn new(
        py: Python<'_>,
        place: &Place,
        pattern: &str,
        max_bytes: u64,
        at_once: usize,
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
        let wanted = Wanted {
            pattern,
            max_bytes,
            max_running: at_once.max(1),
        };
        let inbox = inbox::Inbox::new(place.0.robot.clone(), wanted);
        Ok(Self(Mutex::new(inbox)))
    }

    /// Handles an offer: the answer, and the id of the transfer if it is running.
    fn on_offer<'py>(
        &self,
        py: Python<'py>,
        offer: &[u8],
    ) -> (Bound<'py, PyBytes>, Option<String>) {
        let decision = lock(&self.0).on_offer(Instant::now(), offer);
        let (answer, known) = match decision {
            Decision::Answer(answer) => (answer, None),
            Decision::Known(id, answer) => (answer, Some(id.to_string())),
        };
        (PyBytes::new(py, &answer.encode()), known)
    }

    /// Returns the next question, or how many seconds to wait (`None`: until something comes).
    fn poll(&self) -> (Option<Question>, Option<f64>) {
        match lock(&self.0).poll(Instant::now()) {
            inbox::Step::Ask(question) => (Some(Question(question)), None),
            inbox::Step::Wait(until) => (None, until.map(seconds_until)),
        }
    }

    /// The asked robot has replied: the transfer that begins, or the id of one that goes on.
    fn on_confirmed(&self, question: &Question, reply: &[u8]) -> Taken {
        match lock(&self.0).on_confirmed(&question.0, reply) {
            None => (None, None),
            Some(Confirmed::Known(id)) => (None, Some(id.to_string())),
            Some(Confirmed::Take(id, offer)) => {
                let offer = *offer;
                (Some(Offered { id, offer }), None)
            }
        }
    }

    /// Nothing more comes of a question.
    fn on_silence(&self, question: &Question) {
        lock(&self.0).on_silence(Instant::now(), &question.0);
    }

    /// It does not begin, because the program takes nothing any more.
    fn on_stopped(&self, offered: &Offered) {
        lock(&self.0).on_ended(offered.id, &Err(Fault::Stopped));
    }

    /// So much of it is there.
    fn on_held(&self, offered: &Offered, held_bytes: u64) {
        lock(&self.0).on_held(offered.id, held_bytes);
    }

    /// It is over; `delivered`: the program has it, or knows why not.
    fn on_ended(&self, offered: &Offered, pull: &Pull, delivered: bool) {
        let how = match &lock(&pull.0).how {
            Some(Ok(_)) if delivered => Ok(()),
            Some(Err(fault)) if delivered => Err(fault.clone()),
            _ => Err(Fault::Stopped),
        };
        lock(&self.0).on_ended(offered.id, &how);
    }
}

#[pymethods]
impl Question {
    /// The robot to ask.
    #[getter]
    fn robot(&self) -> &str {
        self.0.from.as_str()
    }

    /// The key, without that robot's `@rect/`.
    #[getter]
    fn key(&self) -> String {
        transfer::source(self.0.id)
    }

    /// How long to wait for the reply, in seconds.
    #[getter]
    fn timeout(&self) -> f64 {
        self.0.timeout.as_secs_f64()
    }

    /// The query's payload.
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
        self.offer.from.as_str()
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

    /// What goes after the sender's `@rect/` for its pieces.
    #[getter]
    fn key(&self) -> String {
        transfer::source(self.id)
    }
}

#[pymethods]
impl Pull {
    /// Begins, or goes on where a restart ended it. `folder`: where it is kept; `None`: in memory.
    #[new]
    fn new(
        py: Python<'_>,
        offered: &Offered,
        folder: Option<PathBuf>,
        patience_s: f64,
    ) -> PyResult<Self> {
        let patience = patience(py, patience_s)?;
        let offer = offered.offer.clone();
        let opened = detached(py, || match folder {
            None => Store::in_memory(offer.size_bytes).map(|store| (store, Default::default())),
            Some(folder) => Store::in_folder(&folder, offered.id, &offer),
        });
        let (store, held, how) = match opened {
            Ok((store, held)) => (Some(store), held, None),
            Err(error) => {
                let fault = Fault::NotKept(error.to_string());
                (None, Default::default(), Some(Err(fault)))
            }
        };
        let now = Instant::now();
        let core = Receiver::new(now, offer.size_bytes, held, patience);
        let saved = (now, core.progress().held_bytes);
        Ok(Self(Mutex::new(Pulling {
            offer,
            core,
            store,
            asks: HashMap::new(),
            saved,
            how,
        })))
    }

    /// What to do now. Takes as long as the checksum, once all is there.
    fn poll<'py>(&self, py: Python<'py>) -> Next<'py> {
        match detached(py, || lock(&self.0).poll()) {
            Step::Ask(ask) => {
                let payload = PyBytes::new(py, &ask.request.encode());
                let (ticket, timeout) = (ask.ticket, ask.timeout.as_secs_f64());
                ("ask", ticket, Some(payload), timeout)
            }
            Step::Wait(until) => ("wait", 0, None, seconds_until(until)),
            Step::Check | Step::Over(_) => ("over", 0, None, 0.0),
        }
    }

    /// A reply has come.
    fn on_reply(&self, py: Python<'_>, ticket: u64, bytes: &[u8]) {
        detached(py, || lock(&self.0).on_reply(ticket, bytes));
    }

    /// An error has come; Zenoh's own, such as that it took too long, is none of the sender's.
    fn on_error(&self, ticket: u64, bytes: &[u8]) {
        if let Some(fault) = Fault::decode(bytes) {
            lock(&self.0).core.on_fault(ticket, fault);
        }
    }

    /// No more comes of a request.
    fn on_end(&self, ticket: u64) {
        let mut pulling = lock(&self.0);
        pulling.asks.remove(&ticket);
        pulling.core.on_silence(Instant::now(), ticket);
    }

    /// Its sender offers it again.
    fn on_offered(&self) {
        lock(&self.0).core.on_offered(Instant::now());
    }

    /// The program wants it no more.
    fn stop(&self) {
        lock(&self.0).core.end(Fault::Stopped);
    }

    /// How many bytes are there, of how many.
    fn progress(&self) -> (u64, u64) {
        let progress = lock(&self.0).core.progress();
        (progress.held_bytes, progress.size_bytes)
    }

    /// Whether it was ended by the program's wish.
    #[getter]
    fn is_stopped(&self) -> bool {
        matches!(lock(&self.0).how, Some(Err(Fault::Stopped)))
    }

    /// What came, once it is over: bytes, or a file's path. Raises why it did not.
    fn content<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let pulling = lock(&self.0);
        match &pulling.how {
            Some(Ok(Content::Bytes(bytes))) => Ok(PyBytes::new(py, bytes).into_any()),
            Some(Ok(Content::File(path))) => {
                Ok(PyString::new(py, &path.to_string_lossy()).into_any())
            }
            Some(Err(fault)) => {
                let Offer { from, topic, .. } = &pulling.offer;
                let text = format!("the transfer {topic} with {from} did not get there: {fault}");
                Err(raised(py, "TransferFailed", (text,)))
            }
            None => Err(raised(py, "TransferFailed", ("it is not over",))),
        }
    }
}

impl Pulling {
    fn poll(&mut self) -> Step {
        if self.how.is_some() {
            return Step::Over(Ok(()));
        }
        self.save_sometimes();
        loop {
            match self.core.poll(Instant::now()) {
                Step::Ask(ask) => {
                    self.asks.insert(ask.ticket, ask.clone());
                    return Step::Ask(ask);
                }
                Step::Wait(until) => return Step::Wait(until),
                Step::Check => self.check(),
                Step::Over(how) => {
                    self.how = Some(self.finish(how));
                    return Step::Over(Ok(()));
                }
            }
        }
    }

    fn on_reply(&mut self, ticket: u64, bytes: &[u8]) {
        // One question, one answer: more would fill the memory.
        let (Some(ask), Some(store)) = (self.asks.remove(&ticket), self.store.as_mut()) else {
            return;
        };
        if !self.core.on_reply(Instant::now(), &ask, bytes.len() as u64) {
            return;
        }
        match store.write(ask.range.start, bytes) {
            Ok(()) => self.core.on_kept(ask.range),
            Err(error) => self.core.on_not_kept(error.to_string()),
        }
    }

    fn check(&mut self) {
        let Some(store) = self.store.as_mut() else {
            return self.core.end(Fault::Stopped);
        };
        match store.checksum() {
            Ok(checksum) => self.core.on_checked(checksum == self.offer.checksum),
            Err(error) => self.core.on_not_kept(error.to_string()),
        }
    }

    fn save_sometimes(&mut self) {
        let (at, bytes) = self.saved;
        let held_bytes = self.core.progress().held_bytes;
        if held_bytes == bytes || at.elapsed() < SAVE_EVERY {
            return;
        }
        if let Some(Err(error)) = self
            .store
            .as_ref()
            .map(|store| store.save(self.core.held()))
        {
            self.core.on_not_kept(error.to_string());
        }
        self.saved = (Instant::now(), held_bytes);
    }

    fn finish(&mut self, how: Result<(), Fault>) -> Result<Content, Fault> {
        let store = self.store.take().ok_or(Fault::Stopped)?;
        match how {
            Ok(()) => store
                .finish()
                .map_err(|error| Fault::NotKept(error.to_string())),
            Err(fault) => {
                // What is not saved is sent again: why it ended counts more.
                let _ = store.interrupt(self.core.held(), &fault);
                Err(fault)
            }
        }
    }
}

/// That it is over, as the sender is told.
#[pyfunction]
pub fn transfer_ended(py: Python<'_>) -> Bound<'_, PyBytes> {
    PyBytes::new(py, &Request::Ended.encode())
}

fn lock<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}
