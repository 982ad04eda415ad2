//! Exposes the sender of a request to a service, and whether it still waits for a reply.
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, Weak},
    time::{Duration, Instant},
};

use pyo3::prelude::*;
use rect_core::{
    catalogue::requester_wait::RequesterWait, message::request::RequestId, session::service,
};

use crate::{
    clock::Clock,
    driver::{lock, Driver},
    key_space::KeySpace,
};

/// The number of requests from which those that have ended are removed.
const SWEEP_AT: usize = 512;

/// The requests to one service that have not ended, by their ids.
#[derive(Default)]
pub struct OpenRequests(Mutex<HashMap<RequestId, Weak<Mutex<Departure>>>>);

/// Whether a requester has left.
#[derive(Default)]
struct Departure {
    has_left: bool,
    is_observed: bool,
    /// The functions to call when it leaves.
    callbacks: Vec<Py<PyAny>>,
}

/// The sender of a request.
#[pyclass(frozen, module = "rect._rect")]
pub struct Requester {
    core: service::Requester,
    arrived_at: Instant,
    departure: Arc<Mutex<Departure>>,
}

impl OpenRequests {
    /// Adds a request that has just arrived.
    pub fn add(&self, core: service::Requester) -> Requester {
        let departure = Arc::default();
        if let Some(header) = &core.header {
            let mut open = lock(&self.0);
            if open.len() >= SWEEP_AT {
                open.retain(|_, departure| departure.strong_count() > 0);
            }
            open.insert(header.id, Arc::downgrade(&departure));
        }
        Requester {
            core,
            arrived_at: Instant::now(),
            departure,
        }
    }

    /// Handles that the requester has closed a request.
    pub fn on_closed(&self, py: Python<'_>, id: RequestId) -> PyResult<()> {
        let departure = lock(&self.0).remove(&id);
        match departure.as_ref().and_then(Weak::upgrade) {
            Some(departure) => leave(py, &departure),
            None => Ok(()),
        }
    }
}

fn leave(py: Python<'_>, departure: &Mutex<Departure>) -> PyResult<()> {
    let callbacks = {
        let mut departure = lock(departure);
        departure.has_left = true;
        std::mem::take(&mut departure.callbacks)
    };
    callbacks
        .iter()
        .try_for_each(|callback| callback.call0(py).map(drop))
}

#[pymethods]
impl Requester {
    /// Name of the robot. `None` if its program does not use RECT.
    #[getter]
    fn robot(&self) -> Option<&str> {
        self.core.robot().map(|robot| robot.as_str())
    }

    /// Whether it expects several replies, and the mark of the last one.
    #[getter]
    fn is_stream(&self) -> bool {
        (self.core.header.as_ref()).is_some_and(|header| header.is_stream)
    }

    /// Time until it stops waiting, in seconds; 0 if it has closed the request, too.
    fn remaining(&self) -> f64 {
        if self.has_left() {
            return 0.0;
        }
        let age = self.arrived_at.elapsed();
        let remaining: Duration = self.core.timeout().saturating_sub(age);
        remaining.as_secs_f64()
    }

    /// Whether it has closed the request, or its program or robot has ended.
    #[getter]
    fn has_left(&self) -> bool {
        lock(&self.departure).has_left
    }

    /// Handles that it does not wait any more.
    fn leave(&self, py: Python<'_>) -> PyResult<()> {
        leave(py, &self.departure)
    }

    /// Calls a function when it does not wait any more, on any thread.
    fn on_left(&self, callback: Py<PyAny>, py: Python<'_>) -> PyResult<()> {
        {
            let mut departure = lock(&self.departure);
            if !departure.has_left {
                departure.callbacks.push(callback);
                return Ok(());
            }
        }
        callback.call0(py).map(drop)
    }

    /// Returns the driver that waits for the end of its program or robot, the first time. `None` if the request does not name them.
    fn observe(&self, key_space: &KeySpace) -> Option<Driver> {
        if std::mem::replace(&mut lock(&self.departure).is_observed, true) {
            return None;
        }
        let wait = RequesterWait::new(key_space.0.clone(), &self.core)?;
        Some(Driver::new(wait, &Clock::new()))
    }
}
