//! Owns what a program has said and heard, as numbers.
use pyo3::prelude::*;
use rect::core::counters;

/// The counters where they are counted.
#[pyclass(frozen, module = "rect._rect")]
pub struct Counting(pub counters::Counting);

#[pymethods]
impl Counting {
    #[new]
    fn new() -> Self {
        Self(counters::Counting::default())
    }

    fn on_sent(&self, bytes: usize) {
        self.0.on_sent(bytes);
    }

    /// Messages sent, their bytes, messages received, their bytes, messages missed, messages rejected.
    fn read(&self) -> (u64, u64, u64, u64, u64, u64) {
        let read = self.0.read();
        (
            read.sent,
            read.sent_bytes,
            read.received,
            read.received_bytes,
            read.missed,
            read.rejected,
        )
    }
}
