//! Combines the library's robot with the runtime on which the calls of C wait.
use std::{future::Future, sync::Arc};

use rect::{blocking::Runtime, Options};

use crate::{failure::Failure, handle::Object};

/// The object behind a `rect_robot`.
#[derive(Clone)]
pub struct Program {
    /// The robot of the library.
    pub robot: rect::Robot,
    /// The runtime on which calls wait.
    pub runtime: Arc<Runtime>,
}

impl Object for Program {
    const KIND: &'static str = "robot";
}

impl Program {
    /// Starts a runtime and connects.
    pub fn connect(options: Options) -> Result<Self, Failure> {
        let cannot_start = |source| rect::Error::Thread { source };
        let runtime = Arc::new(Runtime::start().map_err(cannot_start)?);
        // An address of the options may be one of Bluetooth.
        rect_links::register();
        let robot = runtime.wait(options.connect())?;
        Ok(Self { robot, runtime })
    }

    /// Waits for a future of the library.
    pub fn wait<T>(
        &self,
        future: impl Future<Output = Result<T, rect::Error>>,
    ) -> Result<T, Failure> {
        Ok(self.runtime.wait(future)?)
    }

    /// Waits for a future that is usually ready at once; see [`Runtime::complete`].
    pub fn complete<T>(
        &self,
        future: impl Future<Output = Result<T, rect::Error>>,
    ) -> Result<T, Failure> {
        Ok(self.runtime.complete(future)?)
    }

    /// Combines another handle of the same robot with the runtime of this program.
    pub fn derive(&self, robot: rect::Robot) -> Self {
        let runtime = self.runtime.clone();
        Self { robot, runtime }
    }
}
