//! Owns the waiting at a queue: Zenoh's threads put in, the program takes out.
use std::{
    ops::Deref,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
    },
};

use tokio::sync::Notify;

use crate::core::queue::{Pushed, Queue};

/// A queue with somebody at either end.
#[derive(Debug)]
pub(super) struct Inbox<T> {
    state: Mutex<State<T>>,
    closed: AtomicBool,
    arrived: Notify,
    taken: Condvar,
}

#[derive(Debug)]
struct State<T> {
    queue: Queue<T>,
    /// How many wait for room: to wake nobody is a system call, too.
    waiting: usize,
}

impl<T> Inbox<T> {
    pub(super) fn new(queue: Queue<T>) -> Arc<Self> {
        Arc::new(Self {
            state: Mutex::new(State { queue, waiting: 0 }),
            closed: AtomicBool::new(false),
            arrived: Notify::new(),
            taken: Condvar::new(),
        })
    }

    /// Puts one in; where the rule is to wait, once there is room. `false`: it was refused, or nobody takes any more.
    pub(super) fn push(&self, item: T) -> bool {
        let mut item = item;
        let mut state = self.state();
        let kept = loop {
            if self.is_closed() {
                return false;
            }
            match state.queue.push(item) {
                Pushed::Full(back) => {
                    item = back;
                    state.waiting += 1;
                    let waited = self.taken.wait(state);
                    state = waited.unwrap_or_else(PoisonError::into_inner);
                    state.waiting -= 1;
                }
                Pushed::Kept | Pushed::DroppedOldest(_) => break true,
                Pushed::DroppedNewest(_) => break false,
            }
        };
        drop(state);
        self.arrived.notify_one();
        kept
    }

    /// Takes the oldest, once there is one; `None`: closed, and empty.
    pub(super) async fn pop(&self) -> Option<T> {
        loop {
            let arrived = self.arrived.notified();
            if let Some(item) = self.try_pop() {
                return Some(item);
            }
            if self.is_closed() {
                return None;
            }
            arrived.await;
        }
    }

    /// Takes the oldest, if there is one.
    pub(super) fn try_pop(&self) -> Option<T> {
        let mut state = self.state();
        let item = state.queue.pop();
        let is_awaited = state.waiting > 0;
        drop(state);
        if item.is_some() && is_awaited {
            self.taken.notify_one();
        }
        item
    }

    pub(super) fn dropped(&self) -> u64 {
        self.state().queue.dropped()
    }

    /// Nothing comes any more; what waits can still be taken.
    pub(super) fn close(&self) {
        let state = self.state();
        self.closed.store(true, Ordering::Release);
        drop(state);
        self.taken.notify_all();
        self.arrived.notify_waiters();
        self.arrived.notify_one();
    }

    pub(super) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    fn state(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Where an inbox is filled: a callback that Zenoh drops, with the session at the latest, which ends the inbox.
pub(super) struct Filling<T>(Arc<Inbox<T>>);

impl<T> Filling<T> {
    pub(super) fn new(inbox: &Arc<Inbox<T>>) -> Self {
        Self(inbox.clone())
    }
}

impl<T> Deref for Filling<T> {
    type Target = Inbox<T>;

    fn deref(&self) -> &Inbox<T> {
        &self.0
    }
}

impl<T> Drop for Filling<T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::queue::WhenFull;

    #[tokio::test]
    async fn who_waits_gets_what_comes_and_the_end() {
        let inbox = Inbox::new(Queue::new(2, WhenFull::NewestWins));
        let waiting = tokio::spawn({
            let inbox = inbox.clone();
            async move { (inbox.pop().await, inbox.pop().await) }
        });
        tokio::task::yield_now().await;
        assert!(inbox.push(1));
        inbox.close();
        assert_eq!(waiting.await.expect("done"), (Some(1), None));
        assert!(!inbox.push(2), "closed");
    }

    #[tokio::test]
    async fn who_has_to_wait_for_room_gets_it_or_the_end() {
        let inbox = Inbox::new(Queue::new(1, WhenFull::Wait));
        assert!(inbox.push(1));
        let pushing = |n| {
            let inbox = inbox.clone();
            tokio::task::spawn_blocking(move || inbox.push(n))
        };
        let second = pushing(2);
        assert_eq!(inbox.pop().await, Some(1));
        assert!(second.await.expect("no panic"));
        let third = pushing(3);
        inbox.close();
        assert!(!third.await.expect("no panic"));
        assert_eq!(inbox.pop().await, Some(2), "what waits can be taken");
        assert_eq!(inbox.pop().await, None);
    }
}
