//! Owns what a program has said and heard, as numbers.
use std::sync::atomic::{AtomicU64, Ordering};

use serde::Serialize;

/// What a program has said and heard, since it joined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counters {
    /// Messages said, answers and requests not counted.
    pub sent: u64,
    /// Their payloads, in bytes, as they were sent.
    pub sent_bytes: u64,
    /// Messages heard, each subscription's.
    pub received: u64,
    /// Their payloads, in bytes, as they came.
    pub received_bytes: u64,
    /// Messages that did not arrive, by their numbers.
    pub missed: u64,
    /// Messages of other Zenoh programs that were dropped because RECT does not allow their topic (control characters, more
    /// than 200 bytes, reserved parts).
    pub rejected: u64,
}

/// The counters where they are counted, by any thread.
#[derive(Debug, Default)]
pub struct Counting {
    sent: AtomicU64,
    sent_bytes: AtomicU64,
    received: AtomicU64,
    received_bytes: AtomicU64,
    missed: AtomicU64,
    rejected: AtomicU64,
}

impl Counting {
    /// A message of so many bytes was said.
    pub fn on_sent(&self, bytes: usize) {
        add(&self.sent, 1);
        add(&self.sent_bytes, bytes as u64);
    }

    /// One was heard, and so many before it were not.
    pub fn on_received(&self, bytes: usize, missed: u32) {
        add(&self.received, 1);
        add(&self.received_bytes, bytes as u64);
        add(&self.missed, missed.into());
    }

    /// A message with an invalid topic was dropped.
    pub fn on_rejected(&self) {
        add(&self.rejected, 1);
    }

    /// As they are now.
    pub fn read(&self) -> Counters {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Counters {
            sent: read(&self.sent),
            sent_bytes: read(&self.sent_bytes),
            received: read(&self.received),
            received_bytes: read(&self.received_bytes),
            missed: read(&self.missed),
            rejected: read(&self.rejected),
        }
    }
}

fn add(counter: &AtomicU64, more: u64) {
    counter.fetch_add(more, Ordering::Relaxed);
}
