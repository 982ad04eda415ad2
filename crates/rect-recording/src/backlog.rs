//! Holds the messages that the disk has not taken yet, in a bounded number of bytes.
use std::collections::VecDeque;

use rect_core::message::urgency::Urgency;

use crate::entry::Entry;

/// The messages that wait for the disk. When there is no room, the oldest one that is not urgent is dropped.
#[derive(Debug)]
pub struct Backlog {
    /// Urgent messages, and all others, each with the number of its arrival.
    queues: [VecDeque<(u64, Entry)>; 2],
    arrived: u64,
    bytes: usize,
    limit: usize,
    dropped: u64,
}

impl Backlog {
    /// Creates a backlog of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self {
            queues: Default::default(),
            arrived: 0,
            bytes: 0,
            limit,
            dropped: 0,
        }
    }

    /// Adds a message. Others may be dropped for it, or it is dropped itself.
    pub fn push(&mut self, entry: Entry) {
        let is_urgent = entry.urgency == Urgency::Urgent;
        while self.bytes + entry.bytes() > self.limit {
            let [urgent, others] = &mut self.queues;
            // An urgent one is only dropped for another one.
            let oldest = match others.pop_front() {
                None if is_urgent => urgent.pop_front(),
                oldest => oldest,
            };
            self.dropped += 1;
            match oldest {
                Some((_, oldest)) => self.bytes -= oldest.bytes(),
                None => return,
            }
        }
        self.bytes += entry.bytes();
        self.arrived += 1;
        let [urgent, others] = &mut self.queues;
        let queue = if is_urgent { urgent } else { others };
        queue.push_back((self.arrived, entry));
    }

    /// Removes and returns the message that arrived first.
    pub fn pop(&mut self) -> Option<Entry> {
        let [urgent, others] = &mut self.queues;
        let number = |queue: &VecDeque<(u64, Entry)>| queue.front().map_or(u64::MAX, |(n, _)| *n);
        let first = if number(urgent) < number(others) {
            urgent
        } else {
            others
        };
        let (_, entry) = first.pop_front()?;
        self.bytes -= entry.bytes();
        Some(entry)
    }

    /// Returns whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.queues.iter().all(VecDeque::is_empty)
    }

    /// Returns how many messages were dropped.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use rect_core::message::{encoding::Encoding, payload::Payload};

    fn entry(sequence: u32, urgency: Urgency) -> Entry {
        Entry {
            topic: "a/b".to_owned(),
            recipient: None,
            payload: Payload::new(vec![0; 100], Encoding::BYTES),
            urgency,
            sequence,
            publisher: None,
            logged: Duration::ZERO,
            sent: Duration::ZERO,
            retained: None,
            foreign: None,
        }
    }

    #[test]
    fn urgent_messages_are_kept_when_others_are_dropped() {
        use Urgency::{Bulk, Normal, Urgent};
        let mut backlog = Backlog::new(3 * entry(0, Normal).bytes());
        for (sequence, urgency) in [Normal, Urgent, Bulk, Normal, Urgent, Normal]
            .into_iter()
            .enumerate()
        {
            backlog.push(entry(sequence as u32, urgency));
        }
        let left: Vec<_> = std::iter::from_fn(|| backlog.pop())
            .map(|entry| entry.sequence)
            .collect();
        assert_eq!((left, backlog.dropped()), (vec![1, 4, 5], 3));
        assert_eq!(backlog.bytes, 0);
        // More urgent ones than there is room for: the oldest ones go.
        for sequence in 0..5 {
            backlog.push(entry(sequence, Urgent));
        }
        backlog.push(entry(5, Normal));
        let left: Vec<_> = std::iter::from_fn(|| backlog.pop())
            .map(|entry| entry.sequence)
            .collect();
        assert_eq!((left, backlog.dropped()), (vec![2, 3, 4], 6));
    }
}
