//! Remembers the fastest messages of a while: those with the smallest difference between the receiver's clock and the time of
//! sending.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// The duration of each part of the window, of which only the smallest difference is stored.
const PART: Duration = Duration::from_secs(10);

/// The smallest differences, in milliseconds.
#[derive(Debug, Default)]
pub struct Fastest {
    /// The beginning of each part of the window, and its smallest difference. A part without messages is not stored.
    parts: VecDeque<(Instant, i64)>,
}

impl Fastest {
    /// Adds the difference of a message that has arrived now.
    pub fn add(&mut self, difference: i64, now: Instant) {
        match self.parts.back_mut() {
            Some((at, smallest)) if now.saturating_duration_since(*at) < PART => {
                *smallest = difference.min(*smallest);
            }
            _ => self.parts.push_back((now, difference)),
        }
    }

    /// Returns the smallest difference.
    pub fn smallest(&self) -> Option<i64> {
        self.parts.iter().map(|&(_, smallest)| smallest).min()
    }

    /// Forgets the parts that began longer ago than `window`.
    pub fn forget_older(&mut self, window: Duration, now: Instant) {
        let is_old = |at: Instant| now.saturating_duration_since(at) > window;
        while self.parts.front().is_some_and(|&(at, _)| is_old(at)) {
            self.parts.pop_front();
        }
    }

    /// Forgets all but the last parts.
    pub fn keep_last(&mut self, parts: usize) {
        let excess = self.parts.len().saturating_sub(parts);
        self.parts.drain(..excess);
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.parts.clear();
    }
}
