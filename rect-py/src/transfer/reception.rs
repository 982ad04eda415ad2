//! Wraps the reception of transfers.
use std::{
    path::PathBuf,
    sync::{Arc, Mutex},
    time::SystemTime,
};

use pyo3::{prelude::*, IntoPyObjectExt};
use rect_core::{
    name::topic::Pattern,
    storage::Store,
    transfer::{
        admission::AdmissionRules,
        reception::{self, Arrival},
    },
};

use super::{file_error, offered::OfferedTransfer, pull::TransferPull};
use crate::{
    clock::Clock,
    detached::detached,
    driver::{lock, Driver, ToPython},
    errors::OrRaise,
    key_space::KeySpace,
};

/// Answers the offers to a program.
#[pyclass(frozen, module = "rect._rect")]
pub struct TransferReception {
    core: Arc<Mutex<reception::TransferReception>>,
    clock: Clock,
}

#[pymethods]
impl TransferReception {
    /// Creates the reception for a pattern. `folder` is where transfers are stored; `None` for memory. Creates the
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
        let core = reception::TransferReception::new(key_space.0.clone(), rules);
        Ok(Self {
            core: Arc::new(Mutex::new(core)),
            clock: Clock::new(),
        })
    }

    /// Returns the driver to execute. It delivers `begin` with an `OfferedTransfer`, and `offered_again` with the id of a
    /// transfer.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Handles the number of bytes of a transfer that are stored.
    fn on_received_bytes(&self, offered: &OfferedTransfer, received_bytes: u64) {
        lock(&self.core).on_received_bytes(offered.id, received_bytes);
    }

    /// Handles that a transfer has arrived, or failed, and waits for the program.
    fn on_untaken(&self, offered: &OfferedTransfer) {
        lock(&self.core).on_untaken(offered.id);
    }

    /// Handles the end of a transfer. `has_room` is whether the program has room for the outcome.
    fn on_ended(&self, offered: &OfferedTransfer, pull: &TransferPull, has_room: bool) {
        lock(&self.core).on_ended(offered.id, pull.result(), has_room);
    }

    /// Accepts no further transfers.
    fn stop(&self) {
        lock(&self.core).stop();
    }
}

impl ToPython for Arrival {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        match self {
            Self::Begin(id, offer) => {
                let offer = *offer;
                ("begin", OfferedTransfer { id, offer }).into_py_any(py)
            }
            Self::OfferedAgain(id) => ("offered_again", id.to_string()).into_py_any(py),
        }
    }
}
