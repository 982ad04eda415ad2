//! Owns the runtime that a robot's calls wait on.
use std::future::Future;

use tokio::runtime::{Builder, Runtime as Tokio};

use crate::failure::Failure;

/// One thread for the library's own tasks; no program's callback runs on it.
#[derive(Debug)]
pub struct Runtime(Option<Tokio>);

impl Runtime {
    /// Starts it.
    pub fn start() -> Result<Self, Failure> {
        let built = Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("rect")
            .enable_all()
            .build();
        let built = built.map_err(|error| Failure::System("no thread can be started", error))?;
        Ok(Self(Some(built)))
    }

    /// Waits for something, on the thread that calls.
    pub fn wait<T>(&self, what: impl Future<Output = T>) -> Result<T, Failure> {
        let runtime = self.0.as_ref().ok_or(Failure::Closed)?;
        Ok(runtime.block_on(what))
    }
}

impl Drop for Runtime {
    fn drop(&mut self) {
        // Not waited for: the last handle may be dropped by a service's function, which runs on one of its threads.
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}
