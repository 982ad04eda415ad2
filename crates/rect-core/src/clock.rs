//! Counts milliseconds: the time that messages and frames carry, and from which their age is derived.
pub mod fastest;
pub mod unix;

use std::time::Instant;

/// A clock of this process that counts milliseconds.
#[derive(Clone, Copy, Debug)]
pub struct MillisecondClock {
    start: Instant,
    start_ms: u64,
}

impl MillisecondClock {
    /// Creates a clock that shows `start_ms` at `start`, and does not jump when the system's clock is set.
    pub fn new(start: Instant, start_ms: u64) -> Self {
        Self { start, start_ms }
    }

    /// Returns the time in milliseconds.
    pub fn at(&self, now: Instant) -> u64 {
        let since = now.saturating_duration_since(self.start);
        self.start_ms.wrapping_add(since.as_millis() as u64)
    }

    /// Returns the low 16 bits of the time in milliseconds.
    pub fn low(&self, now: Instant) -> u16 {
        self.at(now) as u16
    }
}
