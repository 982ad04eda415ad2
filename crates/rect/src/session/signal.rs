//! Wakes the task or thread that runs a driver.
use std::{
    sync::{Condvar, Mutex, PoisonError},
    time::Instant,
};

use tokio::sync::Notify;

/// A signal that one task or one thread waits for. It stays set until that has seen it.
#[derive(Default)]
pub(super) struct Signal {
    is_set: Mutex<bool>,
    changed: Condvar,
    notify: Notify,
}

impl Signal {
    /// Sets the signal.
    pub(super) fn set(&self) {
        *self.is_set.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.changed.notify_one();
        self.notify.notify_one();
    }

    /// Waits for the signal, at most until this time.
    pub(super) async fn wait_until(&self, until: Option<Instant>) {
        let notified = self.notify.notified();
        match until {
            Some(until) => drop(tokio::time::timeout_at(until.into(), notified).await),
            None => notified.await,
        }
    }

    /// Does the same on a thread that may be blocked.
    pub(super) fn block_until(&self, until: Instant) {
        let mut is_set = self.is_set.lock().unwrap_or_else(PoisonError::into_inner);
        while !std::mem::take(&mut *is_set) {
            let remaining = until.saturating_duration_since(Instant::now());
            if remaining.is_zero() {
                return;
            }
            let waited = self.changed.wait_timeout(is_set, remaining);
            is_set = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
