//! Wraps the receiving end of a transfer.
use std::{
    path::PathBuf,
    sync::{Arc, Mutex},
};

use pyo3::{
    prelude::*,
    types::{PyBytes, PyString},
    IntoPyObjectExt,
};
use rect_core::{
    storage::{Concluded, Content, Files, Store},
    transfer::{files::UsesFiles, pull, Fault, Offer},
};

use super::offered::OfferedTransfer;
use crate::{
    clock::Clock,
    detached::detached,
    driver::{lock, seconds, Driver, ToPython},
    errors::raised,
    key_space::KeySpace,
};

/// An incoming transfer.
#[pyclass(frozen, module = "rect._rect")]
pub struct TransferPull {
    offer: Offer,
    core: Arc<Mutex<pull::TransferPull>>,
    clock: Clock,
    store: Mutex<Option<Store>>,
    result: Mutex<Option<Result<Content, Fault>>>,
}

/// The result with which the driver of an incoming transfer has finished.
#[pyclass(frozen, module = "rect._rect")]
pub struct PullOutcome(Result<(), Fault>);

#[pymethods]
impl TransferPull {
    /// Begins a transfer, or continues one that a restart interrupted. `folder` is where it is stored; `None` for
    /// memory. `timeout_s` is how long nothing may arrive before the transfer fails.
    #[new]
    fn new(
        py: Python<'_>,
        key_space: &KeySpace,
        offered: &OfferedTransfer,
        folder: Option<PathBuf>,
        timeout_s: f64,
    ) -> Self {
        let (id, offer) = (offered.id, offered.offer.clone());
        let opened = detached(py, || match folder {
            None => Store::in_memory(offer.size_bytes).map(|store| (store, Default::default())),
            Some(folder) => Store::in_folder(&folder, id, &offer),
        });
        let (store, held, result) = match opened {
            Ok((store, held)) => (Some(store), held, None),
            Err(error) => {
                let fault = Fault::NotStored(error.to_string());
                (None, Default::default(), Some(Err(fault)))
            }
        };
        let clock = Clock::new();
        let now = clock.created_at();
        let timeout = seconds(timeout_s);
        let core = pull::TransferPull::new(&key_space.0, id, &offer, held, timeout, now);
        Self {
            offer,
            core: Arc::new(Mutex::new(core)),
            clock,
            store: Mutex::new(store),
            result: Mutex::new(result),
        }
    }

    /// Returns the driver to execute; `None` if there is no storage for the transfer.
    fn driver(&self) -> Option<Driver> {
        let has_store = lock(&self.store).is_some();
        has_store.then(|| Driver::shared(&self.core, &self.clock))
    }

    /// Stores the pieces that have arrived. To be called before the driver is polled.
    fn perform_files(&self, py: Python<'_>) {
        loop {
            let action = lock(&self.core).poll_file();
            let Some(action) = action else { return };
            let event = detached(py, || {
                let mut store = lock(&self.store);
                store.as_mut().map(|store| store.perform(action))
            });
            let Some(event) = event else { return };
            lock(&self.core).on_file(self.clock.now(), event);
        }
    }

    /// Handles a repeated offer of the sender.
    fn on_offered(&self) {
        lock(&self.core).on_offered(self.clock.now());
    }

    /// Stops the transfer on behalf of the program.
    fn stop(&self) {
        lock(&self.core).stop();
    }

    /// Ends the storage, after the driver has finished with `outcome` (`None` if it could not run). Returns a warning for
    /// the log, if there is one.
    fn conclude(&self, py: Python<'_>, outcome: Option<&PullOutcome>) -> Option<String> {
        let store = lock(&self.store).take()?;
        let result = outcome.map_or(Err(Fault::Stopped), |outcome| outcome.0.clone());
        let held = lock(&self.core).held().clone();
        let Concluded { result, warning } = detached(py, || store.conclude(result, &held));
        *lock(&self.result) = Some(result);
        warning
    }

    /// Returns the driver that notifies the sender of the end.
    fn end_report(&self) -> Driver {
        Driver::new(lock(&self.core).end_report(), &Clock::new())
    }

    /// Whether the program stopped the transfer.
    #[getter]
    fn is_stopped(&self) -> bool {
        matches!(&*lock(&self.result), None | Some(Err(Fault::Stopped)))
    }

    /// Returns the content once the transfer has ended: bytes, or the path of a file. Raises `TransferFailed`.
    fn content<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let result = lock(&self.result);
        match result.as_ref().unwrap_or(&Err(Fault::Stopped)) {
            Ok(Content::Bytes(bytes)) => Ok(PyBytes::new(py, bytes).into_any()),
            Ok(Content::File(path)) => Ok(PyString::new(py, &path.to_string_lossy()).into_any()),
            Err(fault) => {
                let Offer { sender, topic, .. } = &self.offer;
                let text = format!("the transfer {topic} with {sender} failed: {fault}");
                Err(raised(py, "TransferFailed", (text,)))
            }
        }
    }
}

impl TransferPull {
    /// Returns the result of the transfer.
    pub(super) fn result(&self) -> Result<(), Fault> {
        match &*lock(&self.result) {
            Some(Ok(_)) => Ok(()),
            Some(Err(fault)) => Err(fault.clone()),
            None => Err(Fault::Stopped),
        }
    }
}

#[pymethods]
impl PullOutcome {
    fn __repr__(&self) -> String {
        match &self.0 {
            Ok(()) => "complete".to_owned(),
            Err(fault) => fault.to_string(),
        }
    }
}

impl ToPython for Result<(), Fault> {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        PullOutcome(self).into_py_any(py)
    }
}
