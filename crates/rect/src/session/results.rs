//! Keeps the large results of this program's actions.
use std::{sync::Arc, time::Instant};

use bytes::Bytes;
use rect_core::{
    action::{result::LargeResult, results::Results},
    driver::Event,
};

use super::{
    executor::Executor,
    robot::Robot,
    shared::{NoItems, Shared},
};
use crate::error::Error;

/// The large results of a program, which are kept until this is dropped.
pub(super) struct KeptResults(Arc<Shared<Results>>);

impl Robot {
    /// Keeps a large result, and replies to the requests for its pieces.
    pub(super) fn keep_result(&self, result: &LargeResult, bytes: Bytes) -> Result<(), Error> {
        let inner = &self.inner;
        let kept = match inner.results.get() {
            Some(kept) => kept,
            None => {
                let results = Results::new(inner.place.clone());
                // A thread, because a reply waits while a link has no room.
                let executor = Executor::new(&inner.session, results, NoItems);
                let started = KeptResults(executor.start_thread("rect-results")?);
                inner.results.get_or_init(|| started)
            }
        };
        kept.0.driver().keep(result, bytes, Instant::now());
        kept.0.wake();
        Ok(())
    }
}

impl Drop for KeptResults {
    fn drop(&mut self) {
        self.0.on_event(Event::Closed);
    }
}
