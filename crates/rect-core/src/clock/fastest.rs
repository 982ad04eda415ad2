//! Remembers the fastest messages of a while: those with the smallest difference between the receiver's clock and the time of
//! sending.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// The duration of each part of the window, of which only the smallest difference is stored.
const PART: Duration = Duration::from_secs(10);

/// The smallest differences, in milliseconds. A difference counts when a second message has confirmed it: one message of a clock
/// that is wrong by years would otherwise make all others seem old.
#[derive(Debug, Default)]
pub struct Fastest {
    parts: VecDeque<Part>,
}

/// A part of the window. One without messages is not stored.
#[derive(Debug)]
struct Part {
    began: Instant,
    smallest: Two,
}

/// The smallest and the second smallest difference; [`NONE`] if there is none.
type Two = [i64; 2];

const NONE: i64 = i64::MAX;

impl Fastest {
    /// Adds the difference of a message that has arrived now.
    pub fn add(&mut self, difference: i64, now: Instant) {
        // The first message has nothing that could confirm it.
        let confirmed = if self.parts.is_empty() {
            difference
        } else {
            NONE
        };
        match self.parts.back_mut() {
            Some(part) if now.saturating_duration_since(part.began) < PART => {
                part.smallest = with(part.smallest, difference);
            }
            _ => self.parts.push_back(Part {
                began: now,
                smallest: [difference, confirmed],
            }),
        }
    }

    /// Returns the smallest difference that was confirmed.
    pub fn smallest(&self) -> Option<i64> {
        let all = self.parts.iter().flat_map(|part| part.smallest);
        let [_, second] = all.fold([NONE; 2], with);
        (second != NONE).then_some(second)
    }

    /// Forgets the parts that began longer ago than `window`.
    pub fn forget_older(&mut self, window: Duration, now: Instant) {
        let is_old = |at: Instant| now.saturating_duration_since(at) > window;
        while self.parts.front().is_some_and(|part| is_old(part.began)) {
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

fn with([first, second]: Two, difference: i64) -> Two {
    if difference < first {
        [difference, first]
    } else {
        [first, second.min(difference)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smallest_difference_counts_when_a_second_message_confirms_it() {
        let (mut fastest, start) = (Fastest::default(), Instant::now());
        let mut add = |second: u64, difference: i64| {
            fastest.add(difference, start + Duration::from_secs(second));
            fastest.smallest()
        };
        assert_eq!(add(0, 50), Some(50), "the first one counts alone");
        assert_eq!(add(1, 90), Some(50));
        assert_eq!(add(2, -1_000_000), Some(50));
        assert_eq!(add(3, 40), Some(40));
        assert_eq!(add(15, 30), Some(30), "of another part");
        assert_eq!(add(16, 20), Some(20));
    }
}
