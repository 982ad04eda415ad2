//! Owns the queue between what comes and the program: bounded, with the core's rules for when it is full.
use pyo3::prelude::*;
use rect::core::queue::{self, Pushed, WhenFull};

use crate::errors::raised;

/// What waits for a program. Whoever uses it sees to it that it is one at a time.
#[pyclass(module = "rect._rect")]
pub struct Queue(queue::Queue<Py<PyAny>>);

#[pymethods]
impl Queue {
    #[new]
    fn new(py: Python<'_>, capacity: usize, when_full: &str) -> PyResult<Self> {
        let when_full = match when_full {
            "newest wins" => WhenFull::NewestWins,
            "oldest wins" => WhenFull::OldestWins,
            "wait" => WhenFull::Wait,
            _ => {
                let known = "it is \"newest wins\", \"oldest wins\" or \"wait\"";
                return Err(raised(py, "OptionError", ("when_full", when_full, known)));
            }
        };
        Ok(Self(queue::Queue::new(capacity, when_full)))
    }

    /// Puts one in: `True`, kept; `False`, dropped; `None`, there is no room, and it is to be tried again.
    fn push(&mut self, item: Py<PyAny>) -> Option<bool> {
        match self.0.push(item) {
            Pushed::Kept | Pushed::DroppedOldest => Some(true),
            Pushed::DroppedNewest => Some(false),
            Pushed::Full(_) => None,
        }
    }

    /// The oldest that waits.
    fn pop(&mut self) -> Option<Py<PyAny>> {
        self.0.pop()
    }

    #[getter]
    fn dropped(&self) -> u64 {
        self.0.dropped()
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }
}
