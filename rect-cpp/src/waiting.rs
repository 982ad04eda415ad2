//! Owns waiting for what comes to a program: for the next, for so long, until it is dropped.
use std::{sync::Arc, time::Duration};

use rect::blocking::Runtime;
use tokio_util::sync::CancellationToken;

use crate::{failure::Failure, handle::Object, program::Program};

/// How long a wait without end takes, for all `timeout_ms` of functions whose names end in `_next`.
pub const FOREVER: u32 = u32::MAX;

/// What a program may wait for.
pub trait Awaited: Send + Sync + 'static {
    /// What it is called in errors.
    const KIND: &'static str;

    /// It was dropped: no callback of it runs any more when this returns.
    fn on_dropped(&self) {}
}

/// What waits for a program, and that nobody waits for it any more once it was dropped.
pub struct Waiting<S> {
    source: S,
    runtime: Arc<Runtime>,
    stop: CancellationToken,
}

impl<S> Waiting<S> {
    /// Something of that program's to wait for.
    pub fn new(source: S, program: &Program) -> Self {
        Self {
            source,
            runtime: program.runtime.clone(),
            stop: CancellationToken::new(),
        }
    }

    /// What is waited for.
    pub fn source(&self) -> &S {
        &self.source
    }

    /// The next `what` within that time.
    pub fn next<'a, T, F>(
        &'a self,
        what: &'static str,
        timeout_ms: u32,
        next: impl FnOnce(&'a S) -> F,
    ) -> Result<T, Failure>
    where
        F: std::future::Future<Output = Option<T>> + 'a,
    {
        let next = next(&self.source);
        let over = async {
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
                () = over => Err(Failure::TimedOut(what, timeout_ms)),
            }
        })
    }
}

impl<S: Awaited> Object for Waiting<S> {
    const KIND: &'static str = S::KIND;

    fn on_dropped(&self) {
        self.stop.cancel();
        self.source.on_dropped();
    }
}
