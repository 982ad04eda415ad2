//! Defines [`Shared`], through which Zenoh's callbacks, the executor and the program reach a driver.
use std::{
    collections::HashMap,
    sync::{Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use rect_core::driver::{Driver, Event, Id, QueryId, MAX_OPEN_QUERIES};
use zenoh::query::Query;

use super::{convert, queries, signal::Signal};

/// Receives the items of a driver. Called on Zenoh's threads and on that of the driver.
pub(super) trait Sink<I>: Send + Sync {
    /// Delivers an item.
    fn deliver(&self, item: I);

    /// Handles that no more items follow.
    fn end(&self) {}
}

/// The sink of a driver without items.
pub(super) struct NoItems;

impl Sink<std::convert::Infallible> for NoItems {
    fn deliver(&self, item: std::convert::Infallible) {
        match item {}
    }
}

/// Locks state that stays valid if a thread panics.
pub(super) fn lock<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Sleeps until that time; for ever without one.
pub(super) async fn sleep_until(at: Option<Instant>) {
    match at {
        Some(at) => tokio::time::sleep_until(at.into()).await,
        None => std::future::pending().await,
    }
}

/// The state that an executor shares with Zenoh's callbacks.
pub(super) struct Shared<D: Driver> {
    driver: Mutex<D>,
    signal: Signal,
    sink: Box<dyn Sink<D::Item>>,
    open_queries: Mutex<OpenQueries>,
}

#[derive(Default)]
struct OpenQueries {
    next: u64,
    queries: HashMap<QueryId, Query>,
}

impl<D: Driver> Shared<D> {
    pub(super) fn new(driver: D, sink: impl Sink<D::Item> + 'static) -> Self {
        Self {
            driver: Mutex::new(driver),
            signal: Signal::default(),
            sink: Box::new(sink),
            open_queries: Mutex::default(),
        }
    }

    /// Reports an event to the driver.
    pub(super) fn on_event(&self, event: Event) {
        let reaction = self.driver().on_event(Instant::now(), event);
        for item in reaction.items {
            self.sink.deliver(item);
        }
        if reaction.polls {
            self.signal.set();
        }
    }

    /// Reports a query. Beyond the limit of open queries it ends without an answer.
    pub(super) fn on_query(&self, id: Id, query: Query) {
        let payload = queries::payload_of(&query);
        let key = query.key_expr().as_str().to_owned();
        let attachment = query.attachment().map(convert::owned);
        let mut open = self.open_queries();
        if open.queries.len() >= MAX_OPEN_QUERIES {
            return;
        }
        let name = QueryId(open.next);
        open.next += 1;
        open.queries.insert(name, query);
        drop(open);
        self.on_event(Event::Query {
            id,
            query: name,
            key,
            payload,
            attachment,
        });
    }

    /// Returns the driver, for what only the program does. Call [`wake`](Self::wake) if it then has something to do.
    pub(super) fn driver(&self) -> MutexGuard<'_, D> {
        lock(&self.driver)
    }

    /// Makes the executor poll the driver.
    pub(super) fn wake(&self) {
        self.signal.set();
    }

    /// Returns the signal to poll the driver.
    pub(super) fn signal(&self) -> &Signal {
        &self.signal
    }

    /// Delivers an item to the program.
    pub(super) fn deliver(&self, item: D::Item) {
        self.sink.deliver(item);
    }

    /// Removes a query that is to be answered.
    pub(super) fn take_query(&self, name: QueryId) -> Option<Query> {
        self.open_queries().queries.remove(&name)
    }

    /// Ends the queries that are not answered, and the items.
    pub(super) fn end(&self) {
        let open = std::mem::take(&mut self.open_queries().queries);
        drop(open);
        self.sink.end();
    }

    fn open_queries(&self) -> MutexGuard<'_, OpenQueries> {
        lock(&self.open_queries)
    }
}
