//! Owns the queue between what arrives and the program that takes it: bounded, with a stated rule for what happens when it is
//! full, and a count of what was dropped.
use std::collections::VecDeque;

/// How many messages wait unless the program says otherwise.
pub const DEFAULT_CAPACITY: usize = 256;

/// What happens when a message comes and the queue is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WhenFull {
    /// The oldest is dropped: what the program gets is fresh.
    #[default]
    NewestWins,
    /// The new one is dropped: what the program gets has no gap before it is full.
    OldestWins,
    /// Whoever sends waits. Nothing is dropped, and a program that does not read holds up everything of that urgency that
    /// comes over the same connection.
    Wait,
}

/// What became of a message.
#[derive(Debug, PartialEq, Eq)]
pub enum Pushed<T> {
    /// It waits.
    Kept,
    /// It waits, and the oldest is gone.
    DroppedOldest(T),
    /// It is gone.
    DroppedNewest(T),
    /// There is no room; to be tried again when something was taken.
    Full(T),
}

/// The queue.
#[derive(Debug)]
pub struct Queue<T> {
    waiting: VecDeque<T>,
    capacity: usize,
    when_full: WhenFull,
    dropped: u64,
}

impl<T> Queue<T> {
    /// For at most `capacity` messages, at least one.
    pub fn new(capacity: usize, when_full: WhenFull) -> Self {
        Self {
            waiting: VecDeque::new(),
            capacity: capacity.max(1),
            when_full,
            dropped: 0,
        }
    }

    /// A message has come.
    pub fn push(&mut self, item: T) -> Pushed<T> {
        if self.waiting.len() < self.capacity {
            self.waiting.push_back(item);
            return Pushed::Kept;
        }
        let oldest = match self.when_full {
            WhenFull::Wait => return Pushed::Full(item),
            WhenFull::NewestWins => self.waiting.pop_front(),
            WhenFull::OldestWins => None,
        };
        self.dropped += 1;
        match oldest {
            Some(oldest) => {
                self.waiting.push_back(item);
                Pushed::DroppedOldest(oldest)
            }
            None => Pushed::DroppedNewest(item),
        }
    }

    /// The oldest that waits.
    pub fn pop(&mut self) -> Option<T> {
        self.waiting.pop_front()
    }

    /// How many were dropped so far.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// How many wait.
    pub fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Whether the next one finds no room.
    pub fn is_full(&self) -> bool {
        self.waiting.len() >= self.capacity
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(when_full: WhenFull) -> (Vec<Pushed<u8>>, Vec<u8>, u64) {
        let mut queue = Queue::new(2, when_full);
        let pushed = (1..=4).map(|n| queue.push(n)).collect();
        let left = std::iter::from_fn(|| queue.pop()).collect();
        (pushed, left, queue.dropped())
    }

    #[test]
    fn when_it_is_full_the_stated_one_goes() {
        use Pushed::{DroppedNewest, DroppedOldest, Full, Kept};
        let (pushed, left, dropped) = filled(WhenFull::NewestWins);
        assert_eq!(pushed, [Kept, Kept, DroppedOldest(1), DroppedOldest(2)]);
        assert_eq!((left, dropped), (vec![3, 4], 2));
        let (pushed, left, dropped) = filled(WhenFull::OldestWins);
        assert_eq!(pushed, [Kept, Kept, DroppedNewest(3), DroppedNewest(4)]);
        assert_eq!((left, dropped), (vec![1, 2], 2));
        let (pushed, left, dropped) = filled(WhenFull::Wait);
        assert_eq!(pushed, [Kept, Kept, Full(3), Full(4)]);
        assert_eq!((left, dropped), (vec![1, 2], 0));
    }
}
