//! Counts the messages that a program sends and receives.
use pyo3::prelude::*;
use rect_core::message::counters;

/// The counters of one program.
#[pyclass(frozen, module = "rect._rect")]
pub struct AtomicCounters(pub counters::AtomicCounters);

#[pymethods]
impl AtomicCounters {
    #[new]
    fn new() -> Self {
        Self(counters::AtomicCounters::default())
    }

    /// Counts one sent message of `bytes` bytes.
    fn on_sent(&self, bytes: usize) {
        self.0.on_sent(bytes);
    }

    /// Counts a message that has expired in the receive queue.
    fn on_expired(&self) {
        self.0.on_expired(0);
    }

    /// Counts a value that does not fit its type.
    fn on_problem(&self) {
        self.0.on_problem();
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
