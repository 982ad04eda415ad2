//! Keeps the large results of this program's actions.
use std::time::Instant;

use bytes::Bytes;
use rect_core::{
    action::{result::LargeResult, results::Results},
    name::key::KeySpace,
};
use zenoh::Session;

use super::{
    executor::{Executor, OnThread},
    shared::NoItems,
};
use crate::error::Error;

/// The large results of a program, which are kept until this is dropped.
pub(super) struct KeptResults(OnThread<Results>);

impl KeptResults {
    /// Starts to keep results, and to reply to the requests for their pieces.
    pub(super) fn start(session: &Session, place: KeySpace) -> Result<Self, Error> {
        // A thread, because a reply waits while a link has no room.
        let executor = Executor::new(session, Results::new(place), NoItems);
        Ok(Self(OnThread::start(executor, "rect-results")?))
    }

    pub(super) fn keep(&self, result: &LargeResult, bytes: Bytes) {
        self.0.driver().keep(result, bytes, Instant::now());
        self.0.wake();
    }
}
