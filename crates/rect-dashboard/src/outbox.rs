//! Holds what waits for one browser: the newest state of each kind, answers, and a bounded number of values.
use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Mutex, MutexGuard, PoisonError},
};

use axum::body::Bytes;
use tokio::sync::Notify;

use crate::protocol::{self, State};

/// The largest number of bytes of values that wait. Beyond it, the oldest ones are dropped.
const MAX_BYTES: usize = 512 * 1024;
/// The largest number of values that wait.
const MAX_VALUES: usize = 256;
/// The largest number of answers that wait. A browser that does not read them gets no more.
const MAX_ANSWERS: usize = 64;

/// The messages that wait for one browser.
#[derive(Default)]
pub struct Outbox {
    waiting: Mutex<Waiting>,
    changed: Notify,
}

#[derive(Default)]
struct Waiting {
    answers: VecDeque<Bytes>,
    /// By their kinds. A newer state replaces the one that waits.
    states: BTreeMap<&'static str, Bytes>,
    values: VecDeque<Bytes>,
    value_bytes: usize,
    dropped: u64,
}

impl Outbox {
    /// Adds a state, in place of an older one of that kind.
    pub fn put_state(&self, kind: &'static str, state: Bytes) {
        self.waiting().states.insert(kind, state);
        self.changed.notify_one();
    }

    /// Adds an answer.
    pub fn put_answer(&self, answer: Bytes) {
        let mut waiting = self.waiting();
        if waiting.answers.len() < MAX_ANSWERS {
            waiting.answers.push_back(answer);
        }
        drop(waiting);
        self.changed.notify_one();
    }

    /// Adds a value. If there is no room, the oldest ones are dropped.
    pub fn put_value(&self, value: Bytes) {
        let mut waiting = self.waiting();
        waiting.value_bytes += value.len();
        waiting.values.push_back(value);
        let mut dropped = 0;
        // The newest value stays, whatever its size.
        while waiting.values.len() > 1
            && (waiting.value_bytes > MAX_BYTES || waiting.values.len() > MAX_VALUES)
        {
            if let Some(oldest) = waiting.values.pop_front() {
                waiting.value_bytes -= oldest.len();
                dropped += 1;
            }
        }
        waiting.add_dropped(dropped);
        drop(waiting);
        self.changed.notify_one();
    }

    /// Counts values that were dropped elsewhere.
    pub fn count_dropped(&self, count: u64) {
        self.waiting().add_dropped(count);
        self.changed.notify_one();
    }

    /// Waits for the next message: answers first, values last.
    pub async fn next(&self) -> Bytes {
        loop {
            if let Some(message) = self.waiting().pop() {
                return message;
            }
            self.changed.notified().await;
        }
    }

    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    fn add_dropped(&mut self, count: u64) {
        if count > 0 {
            self.dropped += count;
            let count = self.dropped;
            let state = protocol::state(&State::Dropped { count });
            self.states.insert("dropped", state);
        }
    }

    fn pop(&mut self) -> Option<Bytes> {
        if let Some(answer) = self.answers.pop_front() {
            return Some(answer);
        }
        if let Some((_, state)) = self.states.pop_first() {
            return Some(state);
        }
        let value = self.values.pop_front()?;
        self.value_bytes -= value.len();
        Some(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drain(outbox: &Outbox) -> Vec<Bytes> {
        std::iter::from_fn(|| outbox.waiting().pop()).collect()
    }

    #[test]
    fn a_slow_browser_gets_the_newest_values_and_their_count() {
        let outbox = Outbox::default();
        for number in 0..1000_u32 {
            outbox.put_value(number.to_le_bytes().to_vec().into());
        }
        let messages = drain(&outbox);
        let newest = 999_u32.to_le_bytes();
        assert_eq!(messages.len(), 1 + MAX_VALUES);
        assert_eq!(messages.last().map(Bytes::as_ref), Some(&newest[..]));
        let text = String::from_utf8_lossy(&messages[0][1..]).into_owned();
        assert!(text.contains(r#""count":744"#), "{text}");
    }

    #[test]
    fn large_values_take_at_most_the_bytes_of_the_limit_or_one_value() {
        let outbox = Outbox::default();
        for size in [MAX_BYTES / 2, MAX_BYTES / 2, 2 * MAX_BYTES, 10] {
            outbox.put_value(vec![0; size].into());
            let waiting = outbox.waiting();
            assert!(waiting.value_bytes <= MAX_BYTES || waiting.values.len() == 1);
        }
        assert_eq!(drain(&outbox).last().map(Bytes::len), Some(10));
    }

    #[test]
    fn a_newer_state_replaces_the_older_one_and_answers_come_first() {
        let outbox = Outbox::default();
        let bytes = |text: &'static str| Bytes::from_static(text.as_bytes());
        outbox.put_value(bytes("value"));
        outbox.put_state("fleet", bytes("old"));
        outbox.put_state("fleet", bytes("new"));
        outbox.put_answer(bytes("answer"));
        assert_eq!(
            drain(&outbox),
            [bytes("answer"), bytes("new"), bytes("value")]
        );
    }
}
