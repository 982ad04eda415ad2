//! Owns callbacks that are called for whatever comes: each has a thread of its own, until it is dropped.
use std::{ffi::c_void, future::Future, sync::Arc, thread};

use crate::{
    callback::Callback,
    failure::Failure,
    handle::{self, Object},
    program::Program,
};

/// A callback that is called for whatever comes, one after another, on a thread of its own, until
/// `rect_drop(&subscription.id, ..)`; that waits for a call that is under way. It may be dropped in its own callback. Two
/// callbacks that drop each other's at the same time wait for each other for ever.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Subscription {
    /// Its handle.
    pub id: u64,
}

struct Called<S> {
    callback: Arc<Callback>,
    source: Arc<S>,
}

impl<S: Source> Object for Called<S> {
    const KIND: &'static str = "subscription";

    fn on_dropped(&self) {
        self.source.close();
        self.callback.close();
    }
}

/// Something that gives one item after another; `None`: there will be no more.
pub trait Source: Send + Sync + 'static {
    /// What it gives.
    type Item;

    /// The next.
    fn next(&self) -> impl Future<Output = Option<Self::Item>>;

    /// No more is wanted: whoever waits for the next is to end.
    fn close(&self);
}

/// Calls `callback` with each item, by `show`.
pub fn start<S: Source>(
    program: &Program,
    source: S,
    callback: Arc<Callback>,
    show: impl Fn(&S::Item, *mut c_void) + Send + 'static,
) -> Result<Subscription, Failure> {
    let source = Arc::new(source);
    let (given, called) = (source.clone(), callback.clone());
    let runtime = program.runtime.clone();
    let thread = thread::Builder::new().name("rect-callback".into());
    let started = thread.spawn(move || {
        let call = |item| called.run(|context| show(&item, context));
        runtime.for_each(|| given.next(), call);
    });
    started.map_err(|error| Failure::System("no thread for the callback", error))?;
    let id = handle::insert(Called { callback, source });
    Ok(Subscription { id })
}
