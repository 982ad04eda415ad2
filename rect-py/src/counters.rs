//! Counts the messages that a program sends and receives, and the problems with them.
use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use rect_core::{
    message::{counters, problems::Problems},
    name::{topic::Topic, Name},
};

use crate::errors::Raised;

/// The counters of one program.
#[pyclass(frozen, module = "rect._rect")]
pub struct AtomicCounters(pub counters::AtomicCounters, Mutex<Problems>);

#[pymethods]
impl AtomicCounters {
    #[new]
    fn new() -> Self {
        Self(counters::AtomicCounters::default(), Mutex::default())
    }

    /// Counts one sent message of `bytes` bytes.
    fn on_sent(&self, bytes: usize) {
        self.0.on_sent(bytes);
    }

    /// Counts a message that has expired in the receive queue.
    fn on_expired(&self) {
        self.0.on_expired(0);
    }

    /// Counts a message or request with a problem. Returns the text of a warning, if there is to be one.
    fn on_problem(&self, sender: &str, topic: &str, problem: &str) -> PyResult<Option<String>> {
        self.0.on_problem();
        let sender = Name::new(sender).map_err(Raised::raised)?;
        let topic = Topic::new(topic).map_err(Raised::raised)?;
        let mut problems = self.1.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(problems.on_problem(&sender, &topic, &problem))
    }

    /// Returns messages sent, their bytes, messages received, their bytes, messages missed, expired and rejected, and problems.
    fn read(&self) -> (u64, u64, u64, u64, u64, u64, u64, u64) {
        let read = self.0.read();
        (
            read.sent,
            read.sent_bytes,
            read.received,
            read.received_bytes,
            read.missed,
            read.expired,
            read.rejected,
            read.problems,
        )
    }
}
