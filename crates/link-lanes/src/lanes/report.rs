//! Defines the counts and the state that lanes report.
use std::{ops::Add, time::Duration};

use serde::Serialize;

/// A number of SDUs with batches, and the size of those batches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// Number of SDUs.
    pub sdus: u64,
    /// Number of bytes, without framing.
    pub bytes: u64,
}

impl Count {
    /// Counts one more SDU with a batch of `bytes` bytes.
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

/// A moving average of times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeanTime(Option<Duration>);

impl MeanTime {
    /// Reciprocal of the weight of one measurement.
    const WEIGHT: u32 = 4;

    /// Adds a measurement.
    pub fn add(&mut self, measured: Duration) {
        let mean = self.0.unwrap_or(measured);
        self.0 = Some((mean * (Self::WEIGHT - 1) + measured) / Self::WEIGHT);
    }

    /// Returns the average; `None` until it was measured.
    pub fn get(self) -> Option<Duration> {
        self.0
    }
}

/// The sending side of a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutLaneReport {
    /// Batches that were sent.
    pub sent: Count,
    /// Batches that wait to be sent; `bytes` is the memory they occupy.
    pub waiting: Count,
    /// Number of bytes of these batches, without framing.
    pub unsent_bytes: u64,
    /// How long the oldest of them has waited.
    pub oldest: Option<Duration>,
    /// Moving average of the time from the queueing of a batch to its acknowledgement; `None` until it was measured.
    pub delay: Option<Duration>,
    /// Number of waiting bytes that count towards the lane's backlog.
    pub backlog_bytes: u64,
    /// Number of SDUs that were withdrawn because Zenoh abandoned their message.
    pub abandoned_sdus: u64,
    /// Whether the peer has stopped the lane.
    pub is_stopped: bool,
}

/// The receiving side of a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InLaneReport {
    /// Batches that were received.
    pub received: Count,
    /// Number of bytes that Zenoh has not read yet, including the overhead of each batch.
    pub unread_bytes: usize,
}
