//! Checks the names that a program uses.
use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use rect_core::{
    name::topic::{Pattern, RobotTopic},
    session::name_check::{self, Used},
};

use crate::{
    clock::Clock,
    driver::Driver,
    errors::OrRaise,
    key_space::{name, KeySpace},
};

/// The names that one program has used. The methods return the check of a name, or nothing if there is no reason for one.
#[pyclass(frozen, module = "rect._rect")]
pub struct UsedNames(Mutex<name_check::UsedNames>);

#[pymethods]
impl UsedNames {
    #[new]
    fn new() -> Self {
        Self(Mutex::default())
    }

    fn on_pattern(&self, key_space: &KeySpace, pattern: &str) -> PyResult<Option<Driver>> {
        let pattern = Pattern::new(pattern).or_raise()?;
        Ok(self.check(key_space, Used::Pattern(pattern)))
    }

    fn on_robot(&self, key_space: &KeySpace, robot: &str) -> PyResult<Option<Driver>> {
        Ok(self.check(key_space, Used::Robot(name(robot)?)))
    }

    fn on_stream(&self, key_space: &KeySpace, stream: &str) -> PyResult<Option<Driver>> {
        let stream = RobotTopic::new(stream).or_raise()?;
        Ok(self.check(key_space, Used::Stream(stream)))
    }

    /// Returns the text of a warning, if there is to be one.
    fn on_topic(&self, topic: &str) -> Option<String> {
        self.core().on_topic(topic)
    }
}

impl UsedNames {
    fn check(&self, key_space: &KeySpace, used: Used) -> Option<Driver> {
        let clock = Clock::new();
        let check = self.core().check(&key_space.0, used, clock.created_at())?;
        Some(Driver::new(check, &clock))
    }

    fn core(&self) -> MutexGuard<'_, name_check::UsedNames> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
