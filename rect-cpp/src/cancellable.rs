//! Waits for the next item of a source, until it arrives, a timeout expires, or the source is dropped.
use std::{future::Future, sync::Arc, time::Duration};

use rect::blocking::Runtime;
use tokio_util::sync::CancellationToken;

use crate::{failure::Failure, handle::Object, program::Program};

/// A timeout that never expires, for the `timeout_ms` parameter of functions whose names end in `_next` or contain `_wait`;
/// for an interval, it means never.
pub const FOREVER: u32 = u32::MAX;

/// The longest timeout that a call of the library is given: about 30 years.
const LONGEST: Duration = Duration::from_secs(1_000_000_000);

/// Converts a timeout for a call of the library.
pub fn timeout(ms: u32) -> Duration {
    match ms {
        FOREVER => LONGEST,
        ms => Duration::from_millis(ms.into()),
    }
}

/// A source of items that a program can wait for.
pub trait Waitable: Send + Sync + 'static {
    /// The kind of the object, for error texts.
    const KIND: &'static str;

    /// Called when the handle is dropped. When this returns, no callback of the source runs any more.
    fn on_dropped(&self) {}
}

/// A source whose waiting calls return as soon as its handle is dropped.
pub struct Cancellable<S> {
    source: S,
    runtime: Arc<Runtime>,
    stop: CancellationToken,
}

impl<S> Cancellable<S> {
    /// Wraps a source that belongs to `program`.
    pub fn new(source: S, program: &Program) -> Self {
        Self {
            source,
            runtime: program.runtime.clone(),
            stop: CancellationToken::new(),
        }
    }

    /// Returns the source.
    pub fn source(&self) -> &S {
        &self.source
    }

    /// Returns the runtime on which calls wait.
    pub fn runtime(&self) -> &Arc<Runtime> {
        &self.runtime
    }

    /// Waits for a call of the library, or until the handle is dropped.
    pub fn wait<'a, T, F>(&'a self, call: impl FnOnce(&'a S) -> F) -> Result<T, Failure>
    where
        F: Future<Output = Result<T, rect::Error>> + 'a,
    {
        let done = call(&self.source);
        self.runtime.wait(async {
            tokio::select! {
                biased;
                () = self.stop.cancelled() => Err(Failure::Closed),
                done = done => Ok(done?),
            }
        })
    }

    /// Waits for a call of the library that is usually ready at once; see [`Runtime::complete`].
    pub fn complete<'a, T, F>(&'a self, call: impl FnOnce(&'a S) -> F) -> Result<T, Failure>
    where
        F: Future<Output = Result<T, rect::Error>> + 'a,
    {
        Ok(self.runtime.complete(call(&self.source))?)
    }

    /// Waits for the next item. `item_name` is its name in the error text.
    pub fn next<'a, T, F>(
        &'a self,
        item_name: &'static str,
        timeout_ms: u32,
        next: impl FnOnce(&'a S) -> F,
    ) -> Result<T, Failure>
    where
        F: Future<Output = Option<T>> + 'a,
    {
        let next = next(&self.source);
        let expired = async {
            match timeout_ms {
                FOREVER => std::future::pending().await,
                ms => tokio::time::sleep(Duration::from_millis(ms.into())).await,
            }
        };
        self.runtime.wait(async {
            tokio::select! {
                biased;
                () = self.stop.cancelled() => Err(Failure::Closed),
                item = next => item.ok_or(Failure::Closed),
                () = expired => Err(Failure::TimedOut(item_name, timeout_ms)),
            }
        })
    }
}

impl<S: Waitable> Object for Cancellable<S> {
    const KIND: &'static str = S::KIND;

    fn on_dropped(&self) {
        self.stop.cancel();
        self.source.on_dropped();
    }
}
