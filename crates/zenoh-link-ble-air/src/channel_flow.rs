//! Keeps the state of one end of a channel as the air reports it: queued bytes, received SDUs, and the end of the channel.
use std::collections::VecDeque;

use parking_lot::Mutex;
use tokio::sync::Notify;

/// State of a channel as reported by the air, and a wake-up for the tasks that wait for a change.
#[derive(Default)]
pub(super) struct ChannelFlow {
    pub(super) inner: Mutex<Flow>,
    changed: Notify,
}

/// The state as the air has reported it.
#[derive(Default)]
pub(super) struct Flow {
    pub(super) queued_bytes: usize,
    pub(super) unread: VecDeque<Vec<u8>>,
    pub(super) is_down: bool,
}

impl ChannelFlow {
    /// Handles that `bytes` of the oldest queued SDU have arrived at the peer.
    pub(super) fn on_sent(&self, bytes: usize) {
        let mut flow = self.inner.lock();
        flow.queued_bytes = flow.queued_bytes.saturating_sub(bytes);
        drop(flow);
        self.changed.notify_waiters();
    }

    /// Handles a received SDU.
    pub(super) fn on_received(&self, sdu: Vec<u8>) {
        let mut flow = self.inner.lock();
        if !flow.is_down {
            flow.unread.push_back(sdu);
        }
        drop(flow);
        self.changed.notify_waiters();
    }

    /// Marks the channel as down. SDUs that arrived before can still be read.
    pub(super) fn on_closed(&self) {
        self.inner.lock().is_down = true;
        self.changed.notify_waiters();
    }

    /// Closes this end and discards unread SDUs.
    pub(super) fn close(&self) {
        let mut flow = self.inner.lock();
        flow.is_down = true;
        flow.unread.clear();
        drop(flow);
        self.changed.notify_waiters();
    }

    /// Waits until `condition` returns a value. Cancel-safe: `condition` has either returned its value or changed
    /// nothing.
    pub(super) async fn wait<T>(&self, mut condition: impl FnMut(&mut Flow) -> Option<T>) -> T {
        loop {
            // Registered before the check, so that a change in between is not missed.
            let changed = self.changed.notified();
            tokio::pin!(changed);
            changed.as_mut().enable();
            if let Some(found) = condition(&mut self.inner.lock()) {
                return found;
            }
            changed.await;
        }
    }
}
