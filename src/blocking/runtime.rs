//! Owns what blocking calls wait on.
use std::{future::Future, io, pin::pin};

use tokio::{
    runtime::{Builder, Runtime as Tokio},
    task::block_in_place,
};

/// One thread for the library's own tasks, and the waiting for them on any other.
#[derive(Debug)]
pub struct Runtime(Option<Tokio>);

impl Runtime {
    /// Starts it.
    ///
    /// # Errors
    /// The system has no thread for it.
    pub fn start() -> io::Result<Self> {
        let mut builder = Builder::new_multi_thread();
        let built = builder.worker_threads(1).thread_name("rect").enable_all();
        Ok(Self(Some(built.build()?)))
    }

    /// Waits for something, on the thread that calls.
    ///
    /// # Panics
    /// On a thread of an async runtime, which it would hold up.
    pub fn wait<T>(&self, what: impl Future<Output = T>) -> T {
        let runtime = self.0.as_ref().expect("there until it is dropped");
        // Pinned here: tokio moves what it is given several times.
        runtime.block_on(pin!(what))
    }

    /// Calls `call` with what comes, on the thread that calls this, until nothing comes any more or it returns `false`.
    /// It may wait for things itself.
    ///
    /// # Panics
    /// As [`wait`](Self::wait).
    pub fn for_each<T, N: Future<Output = Option<T>>>(
        &self,
        next: impl Fn() -> N,
        mut call: impl FnMut(T) -> bool,
    ) {
        self.wait(async {
            while let Some(item) = next().await {
                // Out of the runtime for as long, which costs less than to wait for each anew.
                if !block_in_place(|| call(item)) {
                    break;
                }
            }
        });
    }
}

impl Drop for Runtime {
    fn drop(&mut self) {
        // Not waited for: the last that needs it may be dropped on its own thread, by a callback.
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}
