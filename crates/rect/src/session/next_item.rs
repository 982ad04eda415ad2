//! Makes a [`futures_core::Stream`] of a function that waits for the next item.
use std::{
    future::Future,
    pin::Pin,
    sync::{Mutex, PoisonError},
    task::{Context, Poll},
};

/// The wait for the next item of a stream, which a poll continues.
pub(super) struct NextItem<T> {
    /// The mutex only makes the type `Sync`; it is never locked.
    waiting: Mutex<Option<Waiting<T>>>,
}

type Waiting<T> = Pin<Box<dyn Future<Output = Option<T>> + Send>>;

impl<T> NextItem<T> {
    /// Polls the wait, which `wait` begins unless it is under way.
    pub(super) fn poll<F>(
        &mut self,
        context: &mut Context<'_>,
        wait: impl FnOnce() -> F,
    ) -> Poll<Option<T>>
    where
        F: Future<Output = Option<T>> + Send + 'static,
    {
        let waiting = self.waiting.get_mut();
        let waiting = waiting.unwrap_or_else(PoisonError::into_inner);
        let next = waiting.get_or_insert_with(|| Box::pin(wait()));
        let polled = next.as_mut().poll(context);
        if polled.is_ready() {
            *waiting = None;
        }
        polled
    }
}

impl<T> Default for NextItem<T> {
    fn default() -> Self {
        Self {
            waiting: Mutex::new(None),
        }
    }
}
