//! Implements the bounded queue between the network and the program, with a rule for the case that it is full and a
//! count of dropped items.
use std::collections::VecDeque;

/// The default number of items that a queue holds.
pub const DEFAULT_CAPACITY: usize = 256;
/// The number of items, taken without a wait, from which on more are expected at once.
const BURST: usize = 16;

/// The rule for a receive queue that is full when an item arrives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WhenFull {
    /// Drops the oldest item, so that the program receives recent ones. The default.
    #[default]
    DropOldest,
    /// Drops the new item, so that the items in the queue stay contiguous.
    DropNewest,
    /// Blocks the sender until there is room. Nothing is dropped, but a program that does not read then blocks
    /// all messages of the same urgency on the same link.
    Block,
}

/// The outcome of [`Queue::push`].
#[derive(Debug, PartialEq, Eq)]
pub enum Pushed<T> {
    /// The item is in the queue.
    Kept,
    /// The item is in the queue. The oldest item, which is returned, was dropped to make room.
    DroppedOldest(T),
    /// The item was dropped.
    DroppedNewest(T),
    /// The queue is full. Push the item again after one was taken.
    Full(T),
}

/// A bounded queue.
#[derive(Debug)]
pub struct Queue<T> {
    waiting: VecDeque<T>,
    capacity: usize,
    when_full: WhenFull,
    dropped: u64,
    /// Number of items taken since the program last waited for one.
    taken_since_wait: usize,
}

impl<T> Queue<T> {
    /// Creates a queue for at most `capacity` items. A capacity of 0 becomes 1.
    pub fn new(capacity: usize, when_full: WhenFull) -> Self {
        Self {
            waiting: VecDeque::new(),
            capacity: capacity.max(1),
            when_full,
            dropped: 0,
            taken_since_wait: 0,
        }
    }

    /// Adds an item, or applies the rule of a full queue.
    pub fn push(&mut self, item: T) -> Pushed<T> {
        if !self.is_full() {
            self.waiting.push_back(item);
            return Pushed::Kept;
        }
        let oldest = match self.when_full {
            WhenFull::Block => return Pushed::Full(item),
            WhenFull::DropOldest => self.waiting.pop_front(),
            WhenFull::DropNewest => None,
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

    /// Returns whether an item that is added now has to wait for room.
    pub fn must_wait(&self) -> bool {
        self.when_full == WhenFull::Block && self.is_full()
    }

    /// Returns whether at most half of the room is taken.
    pub fn is_half_empty(&self) -> bool {
        self.waiting.len() <= self.capacity / 2
    }

    /// Removes and returns the oldest item.
    pub fn pop(&mut self) -> Option<T> {
        let item = self.waiting.pop_front();
        let taken = usize::from(item.is_some());
        self.taken_since_wait = self.taken_since_wait.saturating_add(taken);
        item
    }

    /// Puts an item back that was removed and not used. It becomes the oldest one, even if the queue is full meanwhile.
    pub fn put_back(&mut self, item: T) {
        self.waiting.push_front(item);
    }

    /// Returns whether a program that finds the queue empty should let other threads run before it waits for an item. In a
    /// burst they fill the queue meanwhile, so that one wake-up serves many items. Never with a rule that drops items: the other
    /// threads may fill the queue more than once.
    pub fn is_burst(&self) -> bool {
        self.when_full == WhenFull::Block && self.taken_since_wait >= BURST
    }

    /// Handles that the program waits for an item.
    pub fn on_wait(&mut self) {
        self.taken_since_wait = 0;
    }

    /// Returns the number of items dropped so far.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Returns the number of items in the queue.
    pub fn len(&self) -> usize {
        self.waiting.len()
    }

    fn is_full(&self) -> bool {
        self.waiting.len() >= self.capacity
    }

    /// Returns whether the queue is empty.
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
    fn a_full_queue_follows_its_rule() {
        use Pushed::{DroppedNewest, DroppedOldest, Full, Kept};
        let (pushed, left, dropped) = filled(WhenFull::DropOldest);
        assert_eq!(pushed, [Kept, Kept, DroppedOldest(1), DroppedOldest(2)]);
        assert_eq!((left, dropped), (vec![3, 4], 2));
        let (pushed, left, dropped) = filled(WhenFull::DropNewest);
        assert_eq!(pushed, [Kept, Kept, DroppedNewest(3), DroppedNewest(4)]);
        assert_eq!((left, dropped), (vec![1, 2], 2));
        let (pushed, left, dropped) = filled(WhenFull::Block);
        assert_eq!(pushed, [Kept, Kept, Full(3), Full(4)]);
        assert_eq!((left, dropped), (vec![1, 2], 0));
    }

    #[test]
    fn a_burst_begins_with_many_items_and_ends_with_a_wait() {
        let mut queue = Queue::new(2, WhenFull::Block);
        let take = |queue: &mut Queue<usize>, items| {
            for n in 0..items {
                assert_eq!(queue.push(n), Pushed::Kept);
                assert_eq!(queue.pop(), Some(n));
            }
            assert_eq!(queue.pop(), None);
        };
        take(&mut queue, BURST - 1);
        assert!(!queue.is_burst());
        take(&mut queue, 1);
        assert!(queue.is_burst());
        queue.on_wait();
        assert!(!queue.is_burst());
        let mut dropping = Queue::new(2, WhenFull::DropOldest);
        take(&mut dropping, 2 * BURST);
        assert!(!dropping.is_burst());
    }

    #[test]
    fn item_that_is_put_back_is_the_oldest() {
        let mut queue = Queue::new(2, WhenFull::DropNewest);
        queue.push(1);
        let item = queue.pop().expect("queued");
        queue.push(2);
        queue.push(3);
        queue.put_back(item);
        let left: Vec<_> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!((left, queue.dropped()), (vec![1, 2, 3], 0));
    }
}
