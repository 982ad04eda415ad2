//! Owns a program's place among the robots, as handles have it: the library's robot, and what its calls wait on.
use std::{future::Future, sync::Arc};

use rect::Options;

use crate::{failure::Failure, handle::Object, runtime::Runtime};

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
        let runtime = Arc::new(Runtime::start()?);
        let robot = runtime.wait(options.connect())??;
        Ok(Self { robot, runtime })
    }

    /// Waits for something that the library does.
    pub fn wait<T>(
        &self,
        what: impl Future<Output = Result<T, rect::Error>>,
    ) -> Result<T, Failure> {
        Ok(self.runtime.wait(what)??)
    }

    /// Another one of the same program.
    pub fn of(&self, robot: rect::Robot) -> Self {
        let runtime = self.runtime.clone();
        Self { robot, runtime }
    }
}
