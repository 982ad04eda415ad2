//! Exposes the drivers of the core. The Python code executes their actions on eclipse-zenoh (`python/rect/executor.py`).
mod fields;
mod report;
mod sessions;
mod step;

pub use fields::{ConnectionsReport, Servers, ToPython};
pub use report::{bytes_of, is_delete, priority_of, Report};
pub use sessions::{
    direct_presence, established_wait, expected_connection, interrupted, no_service, not_reachable,
    observer, peer_wait, peers_query, reachable_robots, registry_change, registry_query,
    router_observer, seconds, throttle,
};
pub use step::{act, get, qos_fields, QosFields};

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use bytes::Bytes;
use pyo3::{prelude::*, pybacked::PyBackedBytes, types::PyTuple};
use rect_core::driver::{self, Event, Id, QueryId};

use crate::{clock::Clock, codec::payload};

/// A driver of the core, which decides what a handle of the program does. It is given events and returns steps.
#[pyclass(frozen, module = "rect._rect")]
pub struct Driver {
    core: Arc<dyn AnyDriver>,
    clock: Clock,
}

/// The items that a driver delivers because of an event, and whether to poll it.
type Reaction = (Vec<Py<PyAny>>, bool);

/// A driver of any type, behind the lock through which the handle of the program reaches it, too.
trait AnyDriver: Send + Sync {
    fn on_event(&self, py: Python<'_>, now: Instant, event: Event) -> PyResult<Reaction>;
    fn poll<'py>(&self, py: Python<'py>, now: Instant) -> PyResult<Bound<'py, PyTuple>>;
}

impl<D> AnyDriver for Mutex<D>
where
    D: driver::Driver + Send,
    D::Item: ToPython,
    D::Output: ToPython,
{
    fn on_event(&self, py: Python<'_>, now: Instant, event: Event) -> PyResult<Reaction> {
        let reaction = lock(self).on_event(now, event);
        let items = reaction.items.into_iter();
        let items: PyResult<_> = items.map(|item| item.to_python(py)).collect();
        Ok((items?, reaction.polls))
    }

    fn poll<'py>(&self, py: Python<'py>, now: Instant) -> PyResult<Bound<'py, PyTuple>> {
        let step = lock(self).poll(now);
        step::step(py, step, now)
    }
}

/// Locks the state of a driver.
pub fn lock<T: ?Sized>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Driver {
    /// Wraps a driver that a handle shares, with the clock of the handle.
    pub(crate) fn shared<D>(core: &Arc<Mutex<D>>, clock: &Clock) -> Self
    where
        D: driver::Driver + Send + 'static,
        D::Item: ToPython,
        D::Output: ToPython,
    {
        Self {
            core: core.clone(),
            clock: clock.clone(),
        }
    }

    /// Wraps a driver that was created with the time of `clock`.
    pub(crate) fn new<D>(core: D, clock: &Clock) -> Self
    where
        D: driver::Driver + Send + 'static,
        D::Item: ToPython,
        D::Output: ToPython,
    {
        Self::shared(&Arc::new(Mutex::new(core)), clock)
    }

    fn on_event(&self, py: Python<'_>, event: Event) -> PyResult<Reaction> {
        self.core.on_event(py, self.clock.now(), event)
    }
}

#[pymethods]
impl Driver {
    /// Returns what to do now: a tuple that begins with the name of the step.
    fn poll<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        self.core.poll(py, self.clock.now())
    }

    /// Handles a sample of a subscriber. Returns the items to deliver, and whether to poll.
    #[pyo3(signature = (id, key, bytes, encoding, attachment=None, is_deleted=false, priority=driver::Sample::PRIORITY))]
    #[allow(clippy::too_many_arguments)] // The fields of a sample.
    fn on_sample(
        &self,
        py: Python<'_>,
        id: u64,
        key: String,
        bytes: PyBackedBytes,
        encoding: &str,
        attachment: Option<PyBackedBytes>,
        is_deleted: bool,
        priority: u8,
    ) -> PyResult<Reaction> {
        let payload = payload(bytes, encoding);
        let sample = fields::sample(key, payload, attachment, is_deleted, priority);
        self.on_event(py, Event::Sample { id: Id(id), sample })
    }

    /// Handles a reply to a query.
    fn on_reply(
        &self,
        py: Python<'_>,
        id: u64,
        key: String,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> PyResult<Reaction> {
        let payload = payload(bytes, encoding);
        let reply = Ok(fields::sample(
            key,
            payload,
            None,
            false,
            driver::Sample::PRIORITY,
        ));
        self.on_event(py, Event::Reply { id: Id(id), reply })
    }

    /// Handles an error reply to a query.
    fn on_error(
        &self,
        py: Python<'_>,
        id: u64,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> PyResult<Reaction> {
        let reply = Err(payload(bytes, encoding));
        self.on_event(py, Event::Reply { id: Id(id), reply })
    }

    /// Handles the end of a query.
    fn on_ended(&self, py: Python<'_>, id: u64) -> PyResult<Reaction> {
        self.on_event(py, Event::Ended { id: Id(id) })
    }

    /// Handles a query that arrived at a queryable. `query` is the number that the executor gave it.
    #[pyo3(signature = (id, query, bytes, encoding, key=String::new(), attachment=None))]
    #[allow(clippy::too_many_arguments)] // The fields of a query.
    fn on_query(
        &self,
        py: Python<'_>,
        id: u64,
        query: u64,
        bytes: PyBackedBytes,
        encoding: &str,
        key: String,
        attachment: Option<PyBackedBytes>,
    ) -> PyResult<Reaction> {
        let event = Event::Query {
            id: Id(id),
            query: QueryId(query),
            key,
            payload: payload(bytes, encoding),
            attachment: attachment.map(Bytes::from_owner),
        };
        self.on_event(py, event)
    }

    /// Handles that a publisher has its first subscriber, or has none any more.
    fn on_matching(&self, py: Python<'_>, id: u64, matching: bool) -> PyResult<Reaction> {
        self.on_event(
            py,
            Event::Matching {
                id: Id(id),
                matching,
            },
        )
    }

    /// Handles that a link of the session came up or went down. `locator` is the address of the peer.
    fn on_link(&self, py: Python<'_>, up: bool, locator: &str) -> PyResult<Reaction> {
        let (method, address) = locator.split_once('/').unwrap_or(("", locator));
        let address = address.split(['?', '#']).next().unwrap_or_default();
        let (method, address) = (method.to_owned(), address.to_owned());
        self.on_event(
            py,
            Event::Link {
                up,
                method,
                address,
            },
        )
    }

    /// Handles that the session or the handle was closed.
    fn on_closed(&self, py: Python<'_>) -> PyResult<Reaction> {
        self.on_event(py, Event::Closed)
    }

    /// Sets the time that the driver sees, in seconds since it was created, for tests.
    fn set_time(&self, elapsed_s: f64) {
        self.clock.freeze(seconds(elapsed_s));
    }
}
