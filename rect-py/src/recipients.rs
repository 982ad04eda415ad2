//! Exposes the observation of the robots that are reachable, for messages to one of them.
use std::sync::{Arc, Mutex};

use pyo3::prelude::*;
use rect_core::session::recipients::{self, Reachability};

use crate::{
    clock::Clock,
    driver::{lock, Driver},
    key_space::{name, KeySpace},
};

/// The robots that are reachable.
#[pyclass(frozen, module = "rect._rect")]
pub struct Recipients {
    core: Arc<Mutex<recipients::Recipients>>,
    clock: Clock,
}

#[pymethods]
impl Recipients {
    #[new]
    fn new(key_space: &KeySpace) -> Self {
        let core = recipients::Recipients::new(key_space.0.clone());
        Self {
            core: Arc::new(Mutex::new(core)),
            clock: Clock::new(),
        }
    }

    /// Returns the driver to execute.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Returns `reachable`, `unreachable` with the robots that are reachable, or `unsure`: then poll the driver. Raises
    /// `InvalidNameError`.
    fn find(&self, robot: &str) -> PyResult<(&'static str, Vec<String>)> {
        let robot = name(robot)?;
        let found = lock(&self.core).find(&robot, self.clock.now());
        Ok(match found {
            Reachability::Reachable => ("reachable", Vec::new()),
            Reachability::Unreachable(available) => {
                let names = available.iter().map(ToString::to_string);
                ("unreachable", names.collect())
            }
            Reachability::Unsure => ("unsure", Vec::new()),
        })
    }
}
