//! Owns a program's place among the robots, as handles have it: the library's robot, and what its calls wait on.
use std::{future::Future, sync::Arc};

use rect::{blocking::Runtime, Options};

use crate::{failure::Failure, handle::Object};

/// What a `rect_robot` is.
#[derive(Clone)]
pub struct Program {
    /// The library's.
    pub robot: rect::Robot,
    /// What calls wait on.
    pub runtime: Arc<Runtime>,
}

impl Object for Program {
    const KIND: &'static str = "robot";
}

impl Program {
    /// Joins.
    pub fn join(options: Options) -> Result<Self, Failure> {
        let no_thread = |error| Failure::System("no thread can be started", error);
        let runtime = Arc::new(Runtime::start().map_err(no_thread)?);
        let robot = runtime.wait(options.connect())?;
        Ok(Self { robot, runtime })
    }

    /// Waits for something that the library does.
    pub fn wait<T>(
        &self,
        what: impl Future<Output = Result<T, rect::Error>>,
    ) -> Result<T, Failure> {
        Ok(self.runtime.wait(what)?)
    }

    /// The same of what is mostly done at once, as [`Runtime::complete`] does it.
    pub fn complete<T>(
        &self,
        what: impl Future<Output = Result<T, rect::Error>>,
    ) -> Result<T, Failure> {
        Ok(self.runtime.complete(what)?)
    }

    /// Another one of the same program.
    pub fn of(&self, robot: rect::Robot) -> Self {
        let runtime = self.runtime.clone();
        Self { robot, runtime }
    }
}
