//! Owns callbacks that are called for whatever comes: each has a thread of its own, until it is dropped.
use std::{ffi::c_void, future::Future, pin::pin, sync::Arc, thread};

use tokio_util::sync::CancellationToken;

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

struct Called {
    callback: Arc<Callback>,
    stop: CancellationToken,
}

impl Object for Called {
    const KIND: &'static str = "subscription";

    fn on_dropped(&self) {
        self.stop.cancel();
        self.callback.close();
    }
}

/// Something that gives one item after another; `None`: there will be no more.
pub trait Source: Send + 'static {
    /// What it gives.
    type Item;

    /// The next.
    fn next(&mut self) -> impl Future<Output = Option<Self::Item>> + Send;
}

/// Calls `callback` with each item, by `show`.
pub fn start<S: Source>(
    program: &Program,
    mut source: S,
    callback: Arc<Callback>,
    show: impl Fn(S::Item, *mut c_void) + Send + 'static,
) -> Result<Subscription, Failure> {
    let stop = CancellationToken::new();
    let (stopped, called) = (stop.clone(), callback.clone());
    let runtime = program.runtime.clone();
    let thread = thread::Builder::new().name("rect-callback".into());
    let started = thread.spawn(move || {
        let mut stopped = pin!(stopped.cancelled());
        let mut next = |source: &mut S| {
            let wait = async {
                tokio::select! {
                    biased;
                    () = &mut stopped => None,
                    item = source.next() => item,
                }
            };
            runtime.wait(wait).ok().flatten()
        };
        while let Some(item) = next(&mut source) {
            if !called.run(|context| show(item, context)) {
                break;
            }
        }
    });
    started.map_err(|error| Failure::System("no thread for the callback", error))?;
    let id = handle::insert(Called { callback, stop });
    Ok(Subscription { id })
}
