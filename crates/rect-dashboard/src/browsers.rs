//! Keeps the browsers that show the page, and the states that all of them show.
use std::{
    collections::BTreeMap,
    sync::{
        atomic::{AtomicUsize, Ordering},
        Arc, Mutex, MutexGuard, PoisonError, Weak,
    },
};

use axum::body::Bytes;

use crate::{
    outbox::Outbox,
    protocol::{self, State},
};

/// The largest number of browsers.
const MAX_BROWSERS: usize = 16;
/// The number of browsers that only those with a login can be.
const RESERVED: usize = 4;

/// The browsers that show the page.
#[derive(Default)]
pub struct Browsers {
    inner: Mutex<Inner>,
    /// How many of them show the list of topics.
    showing_topics: AtomicUsize,
}

#[derive(Default)]
struct Inner {
    open: Vec<Weak<Outbox>>,
    states: BTreeMap<&'static str, Bytes>,
}

/// Counts a browser that shows the list of topics, until it is dropped.
pub struct ShowingTopics(Arc<Browsers>);

impl Browsers {
    /// Adds a browser, which gets all states. `is_reserved`: it may take a reserved place. `None`: there are too many.
    pub fn open(&self, is_reserved: bool) -> Option<Arc<Outbox>> {
        let mut inner = self.inner();
        inner.open.retain(|outbox| outbox.strong_count() > 0);
        let max = match is_reserved {
            true => MAX_BROWSERS,
            false => MAX_BROWSERS - RESERVED,
        };
        if inner.open.len() >= max {
            return None;
        }
        let outbox = Arc::new(Outbox::default());
        for (kind, state) in &inner.states {
            outbox.put_state(kind, state.clone());
        }
        inner.open.push(Arc::downgrade(&outbox));
        Some(outbox)
    }

    /// Returns whether a browser shows the page.
    pub fn any(&self) -> bool {
        let inner = self.inner();
        inner.open.iter().any(|outbox| outbox.strong_count() > 0)
    }

    /// Returns whether a browser shows the list of topics.
    pub fn show_topics(&self) -> bool {
        self.showing_topics.load(Ordering::Relaxed) > 0
    }

    /// Counts a browser that shows the list of topics.
    pub fn count_topics(self: &Arc<Self>) -> ShowingTopics {
        self.showing_topics.fetch_add(1, Ordering::Relaxed);
        ShowingTopics(self.clone())
    }

    /// Sends a state to all browsers if it has changed, and to those that come later.
    pub fn publish(&self, kind: &'static str, state: &State<'_>) {
        let state = protocol::state(state);
        let mut inner = self.inner();
        if inner.states.get(kind) == Some(&state) {
            return;
        }
        for outbox in inner.open.iter().filter_map(Weak::upgrade) {
            outbox.put_state(kind, state.clone());
        }
        inner.states.insert(kind, state);
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for ShowingTopics {
    fn drop(&mut self) {
        self.0.showing_topics.fetch_sub(1, Ordering::Relaxed);
    }
}
