//! Exposes the large results of goals: those that this program keeps, and those that it receives.
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use pyo3::{prelude::*, IntoPyObjectExt};
use rect_core::{
    action::{
        pull::{self, PullError},
        result::LargeResult,
        results,
    },
    message::payload::Payload,
};

use crate::{
    clock::Clock,
    codec::parts,
    driver::{lock, Driver, ToPython},
    key_space::KeySpace,
};

/// The large results of the goals of this program.
#[pyclass(frozen, module = "rect._rect")]
pub struct Results {
    core: Arc<Mutex<results::Results>>,
    clock: Clock,
}

/// A large result that a program is to keep.
#[pyclass(frozen, module = "rect._rect")]
pub struct ResultToKeep(pub LargeResult, pub Bytes);

/// A large result that is being received.
#[pyclass(frozen, module = "rect._rect")]
pub struct ResultPull {
    pub(super) core: Arc<Mutex<pull::ResultPull>>,
    pub(super) clock: Clock,
}

#[pymethods]
impl Results {
    #[new]
    fn new(key_space: &KeySpace) -> Self {
        let results = results::Results::new(key_space.0.clone());
        Self {
            core: Arc::new(Mutex::new(results)),
            clock: Clock::new(),
        }
    }

    /// Returns the driver to execute.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Keeps a result.
    fn keep(&self, result: &ResultToKeep) {
        let ResultToKeep(described, bytes) = result;
        lock(&self.core).keep(described, bytes.clone(), self.clock.now());
    }
}

#[pymethods]
impl ResultPull {
    /// Returns the driver to execute. It finishes with `received` and the payload, `unavailable` and the reason, or `closed`.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Stops it on behalf of the program.
    fn stop(&self) {
        lock(&self.core).stop();
    }

    /// The description of the result, for the text of a timeout.
    #[getter]
    fn expected(&self) -> String {
        lock(&self.core).expected()
    }
}

impl ToPython for Result<Payload, PullError> {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        match self {
            Ok(payload) => ("received", parts(py, &payload)).into_py_any(py),
            Err(PullError::Unavailable(reason)) => ("unavailable", reason).into_py_any(py),
            Err(PullError::Closed) => ("closed", py.None()).into_py_any(py),
        }
    }
}
