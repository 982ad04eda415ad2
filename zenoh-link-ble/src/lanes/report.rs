//! Owns what can be told of the lanes while they work: plain counts, kept always.
use std::{ops::Add, time::Duration};

use serde::Serialize;

/// SDUs with batches, and the bytes of those batches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// SDUs.
    pub sdus: u64,
    /// Bytes, without framing.
    pub bytes: u64,
}

impl Count {
    /// One more.
    pub fn count(&mut self, bytes: usize) {
        self.sdus += 1;
        self.bytes += bytes as u64;
    }
}

impl Add for Count {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            sdus: self.sdus + other.sdus,
            bytes: self.bytes + other.bytes,
        }
    }
}

/// A lane, the sending side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutLaneReport {
    /// What went out.
    pub sent: Count,
    /// What waits; its bytes are those it takes of the memory.
    pub waiting: Count,
    /// How long the oldest has waited.
    pub oldest: Option<Duration>,
    /// Bytes that wait and count towards the lane's backlog.
    pub backlog_bytes: u64,
    /// SDUs taken back because Zenoh gave their message up.
    pub given_up_sdus: u64,
    /// The peer takes nothing of it now.
    pub is_stopped: bool,
}

/// A lane, the receiving side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InLaneReport {
    /// What came.
    pub received: Count,
    /// Bytes that nobody has taken yet, with what each batch takes besides.
    pub held_bytes: usize,
}
