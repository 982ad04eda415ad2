//! Reports to a service whether somebody still waits for its reply.
use std::{
    collections::HashMap,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, Mutex, OnceLock, PoisonError, Weak,
    },
};

use rect_core::{
    catalogue::requester_wait::RequesterWait, message::request::RequestId,
    session::service::Requester,
};
use tokio::{sync::Notify, task::AbortHandle, time::Instant};

use super::{executor::Executor, robot::Inner, shared::NoItems};

/// The number of requests from which those that have ended are removed.
const SWEEP_AT: usize = 512;

/// The requests to one service that have not ended, by their ids.
#[derive(Default)]
pub(super) struct OpenRequests(Mutex<HashMap<RequestId, Weak<Departure>>>);

/// Whether the requester has left.
#[derive(Default)]
struct Departure {
    has_left: AtomicBool,
    left: Notify,
}

/// The requester of one request.
pub(super) struct WaitingRequester {
    requester: Requester,
    deadline: Instant,
    departure: Arc<Departure>,
    inner: Weak<Inner>,
    /// The task that observes it. It begins when the program asks for the first time.
    observer: OnceLock<Option<AbortHandle>>,
}

impl OpenRequests {
    /// Adds a request of a requester.
    pub(super) fn add(
        &self,
        requester: Requester,
        deadline: Instant,
        inner: &Weak<Inner>,
    ) -> WaitingRequester {
        let departure = Arc::new(Departure::default());
        if let Some(header) = &requester.header {
            let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            if open.len() >= SWEEP_AT {
                open.retain(|_, departure| departure.strong_count() > 0);
            }
            open.insert(header.id, Arc::downgrade(&departure));
        }
        WaitingRequester {
            requester,
            deadline,
            departure,
            inner: inner.clone(),
            observer: OnceLock::new(),
        }
    }

    /// Handles that the requester has closed a request.
    pub(super) fn on_closed(&self, id: RequestId) {
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let departure = open.remove(&id);
        drop(open);
        if let Some(departure) = departure.as_ref().and_then(Weak::upgrade) {
            departure.leave();
        }
    }
}

impl Departure {
    fn leave(&self) {
        self.has_left.store(true, Ordering::Relaxed);
        self.left.notify_waiters();
    }

    fn has_left(&self) -> bool {
        self.has_left.load(Ordering::Relaxed)
    }
}

impl WaitingRequester {
    pub(super) fn requester(&self) -> &Requester {
        &self.requester
    }

    /// Returns the time until which it waits.
    pub(super) fn deadline(&self) -> Instant {
        self.deadline
    }

    /// Returns whether the deadline has passed, or the requester has announced that it has closed the request.
    pub(super) fn has_left(&self) -> bool {
        self.departure.has_left() || Instant::now() >= self.deadline
    }

    /// Returns whether the requester still waits, and observes it from now on.
    pub(super) fn is_waiting(&self) -> bool {
        self.observe();
        !self.has_left()
    }

    /// Waits until the requester has left.
    pub(super) async fn left(&self) {
        self.observe();
        let left = self.departure.left.notified();
        // It may have left before.
        if !self.has_left() {
            left.await;
        }
    }

    fn observe(&self) {
        self.observer.get_or_init(|| {
            let (departure, deadline) = (self.departure.clone(), self.deadline);
            let Some(inner) = self.inner.upgrade() else {
                departure.leave();
                return None;
            };
            let wait = RequesterWait::new(inner.place.clone(), &self.requester);
            let session = inner.session.clone();
            let observing = inner.runtime.spawn(async move {
                match wait {
                    Some(wait) => {
                        let observed = Executor::new(&session, wait, NoItems).run();
                        // An error means that the session is closed.
                        let _ = tokio::time::timeout_at(deadline, observed).await;
                    }
                    None => tokio::time::sleep_until(deadline).await,
                }
                departure.leave();
            });
            Some(observing.abort_handle())
        });
    }
}

impl Drop for WaitingRequester {
    fn drop(&mut self) {
        if let Some(Some(observer)) = self.observer.get() {
            observer.abort();
        }
    }
}
