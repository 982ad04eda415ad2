//! Counts the messages and bytes that a program has sent and received.
use std::sync::atomic::{AtomicU64, Ordering};

use serde::Serialize;

/// How many messages and bytes a program has sent and received since it joined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counters {
    /// Messages sent, without requests and replies.
    pub sent: u64,
    /// Payload bytes of these messages, after encoding with a codec.
    pub sent_bytes: u64,
    /// Messages received, counted for each subscription.
    pub received: u64,
    /// Payload bytes of these messages, before decoding.
    pub received_bytes: u64,
    /// Messages that did not arrive, according to their sequence numbers.
    pub missed: u64,
    /// Messages that had expired on arrival, before the program has read them, or before they could be sent.
    pub expired: u64,
    /// Messages of other Zenoh programs that were dropped because RECT does not allow their topic (control characters,
    /// more than 200 bytes, reserved parts).
    pub rejected: u64,
    /// Messages whose payload cannot be decoded, and messages and requests whose value does not fit the type that the program
    /// states.
    pub problems: u64,
}

/// Counters that any thread can update.
#[derive(Debug, Default)]
pub struct AtomicCounters {
    sent: AtomicU64,
    sent_bytes: AtomicU64,
    received: AtomicU64,
    received_bytes: AtomicU64,
    missed: AtomicU64,
    expired: AtomicU64,
    rejected: AtomicU64,
    problems: AtomicU64,
}

impl AtomicCounters {
    /// Counts a sent message with a payload of `bytes` bytes.
    pub fn on_sent(&self, bytes: usize) {
        add(&self.sent, 1);
        add(&self.sent_bytes, bytes as u64);
    }

    /// Counts a received message with a payload of `bytes` bytes, and the `missed` messages before it that did not
    /// arrive.
    pub fn on_received(&self, bytes: usize, missed: u32) {
        add(&self.received, 1);
        add(&self.received_bytes, bytes as u64);
        // Few messages are missed, and each operation on a shared counter costs time.
        if missed > 0 {
            add(&self.missed, missed.into());
        }
    }

    /// Counts a message that has expired, and the `missed` messages before it that did not arrive and are not counted yet.
    pub fn on_expired(&self, missed: u32) {
        add(&self.expired, 1);
        add(&self.missed, missed.into());
    }

    /// Counts a message that was dropped because of its invalid topic.
    pub fn on_rejected(&self) {
        add(&self.rejected, 1);
    }

    /// Counts a value that does not fit its type.
    pub fn on_problem(&self) {
        add(&self.problems, 1);
    }

    /// Returns the current values.
    pub fn read(&self) -> Counters {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Counters {
            sent: read(&self.sent),
            sent_bytes: read(&self.sent_bytes),
            received: read(&self.received),
            received_bytes: read(&self.received_bytes),
            missed: read(&self.missed),
            expired: read(&self.expired),
            rejected: read(&self.rejected),
            problems: read(&self.problems),
        }
    }
}

fn add(counter: &AtomicU64, more: u64) {
    counter.fetch_add(more, Ordering::Relaxed);
}
