//! Runs a callback for each item of a source, on a thread of its own, until the subscription is dropped.
use std::{ffi::c_void, future::Future, sync::Arc, thread};

use rect::blocking::Runtime;

use crate::{
    callback::Callback,
    failure::Failure,
    handle::{self, Object},
};

/// A subscription, watch or event listener that calls a callback for each item, one after another, on a thread of its own,
/// until `rect_drop(&subscription.id, ..)`.
///
/// Dropping it waits for a call in progress. A callback may drop its own subscription. If two callbacks drop each other's
/// subscriptions at the same time, both wait forever.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Subscription {
    /// The handle.
    pub id: u64,
}

struct CallbackSubscription<S> {
    callback: Arc<Callback>,
    source: Arc<S>,
}

impl<S: Source> Object for CallbackSubscription<S> {
    const KIND: &'static str = "subscription";

    fn on_dropped(&self) {
        self.source.close();
        self.callback.close();
    }
}

/// A source of items. After `None` there are no more.
pub trait Source: Send + Sync + 'static {
    /// The type of its items.
    type Item;

    /// Waits for the next item.
    fn next(&self) -> impl Future<Output = Option<Self::Item>>;

    /// Ends the source. A waiting `next` returns `None`.
    fn close(&self);
}

/// Starts a thread that passes each item of `source` to `callback`, using `invoke`.
pub fn start<S: Source>(
    runtime: &Arc<Runtime>,
    source: S,
    callback: Arc<Callback>,
    invoke: impl Fn(&S::Item, *mut c_void) + Send + 'static,
) -> Result<Subscription, Failure> {
    let source = Arc::new(source);
    let (items, wrapper) = (source.clone(), callback.clone());
    let runtime = runtime.clone();
    let thread = thread::Builder::new().name("rect-callback".into());
    let started = thread.spawn(move || {
        let call = |item| wrapper.run(|context| invoke(&item, context));
        runtime.for_each(|| items.next(), call);
    });
    started.map_err(|source| rect::Error::Thread { source })?;
    let id = handle::insert(CallbackSubscription { callback, source });
    Ok(Subscription { id })
}
