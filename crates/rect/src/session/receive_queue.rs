//! Implements the blocking and asynchronous ends of a receive queue: Zenoh's threads push, the program pops.
use std::{
    ops::Deref,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError,
    },
    thread::{self, ThreadId},
};

use rect_core::message::queue::{Pushed, Queue};
use tokio::sync::Notify;

use super::shared::Sink;

/// A queue between Zenoh's threads and the program.
#[derive(Debug)]
pub(super) struct ReceiveQueue<T> {
    state: Mutex<State<T>>,
    closed: AtomicBool,
    /// The thread that dropped the writing end.
    finished_on: OnceLock<ThreadId>,
    arrived: Notify,
    taken: Condvar,
}

#[derive(Debug)]
struct State<T> {
    queue: Queue<T>,
    /// Number of threads that wait for room and that no call of `try_pop` has woken; if it is 0, the system call that wakes one is
    /// skipped.
    waiting: usize,
}

impl<T> ReceiveQueue<T> {
    pub(super) fn new(queue: Queue<T>) -> Arc<Self> {
        Arc::new(Self {
            state: Mutex::new(State { queue, waiting: 0 }),
            closed: AtomicBool::new(false),
            finished_on: OnceLock::new(),
            arrived: Notify::new(),
            taken: Condvar::new(),
        })
    }

    /// Adds an item. If the queue is full and its rule is to block, waits for room. Returns `false` if the item was dropped
    /// or the queue is closed.
    pub(super) fn push(&self, item: T) -> bool {
        let mut state = self.state();
        while state.queue.must_wait() && !self.is_closed() {
            state.waiting += 1;
            let waited = self.taken.wait(state);
            state = waited.unwrap_or_else(PoisonError::into_inner);
        }
        if self.is_closed() {
            return false;
        }
        let kept = matches!(
            state.queue.push(item),
            Pushed::Kept | Pushed::DroppedOldest(_)
        );
        drop(state);
        self.arrived.notify_one();
        kept
    }

    /// Waits for the oldest item and removes it; returns `None` once the queue is closed and empty.
    pub(super) async fn pop(&self) -> Option<T> {
        loop {
            if let Some(item) = self.try_pop() {
                return Some(item);
            }
            if self.state().queue.is_burst() {
                // The thread yields, not only the task: what fills the queue are other threads, perhaps on the same core.
                thread::yield_now();
            }
            let arrived = self.arrived.notified();
            if let Some(item) = self.try_pop() {
                return Some(item);
            }
            if self.is_closed() {
                return None;
            }
            self.state().queue.on_wait();
            arrived.await;
        }
    }

    /// Removes the oldest item, if there is one.
    pub(super) fn try_pop(&self) -> Option<T> {
        let mut state = self.state();
        let item = state.queue.pop();
        // One wake-up for several items: a blocked thread continues when the queue is half empty.
        let is_awaited = item.is_some() && state.waiting > 0 && state.queue.is_half_empty();
        // Counted here, because the thread may wait long for a processor, and is not woken again for each item meanwhile.
        state.waiting -= usize::from(is_awaited);
        drop(state);
        if is_awaited {
            self.taken.notify_one();
        }
        item
    }

    /// Does the same as [`pop`](Self::pop), and puts the item back if the returned guard is dropped.
    pub(super) async fn pop_guarded(&self) -> Option<Popped<'_, T>> {
        let item = Some(self.pop().await?);
        Some(Popped { item, queue: self })
    }

    fn put_back(&self, item: T) {
        self.state().queue.put_back(item);
        self.arrived.notify_one();
    }

    pub(super) fn dropped(&self) -> u64 {
        self.state().queue.dropped()
    }

    /// Rejects further items; those in the queue can still be removed.
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

    /// Returns whether the writing end was dropped on this thread.
    pub(super) fn is_finished_here(&self) -> bool {
        self.finished_on.get() == Some(&thread::current().id())
    }

    fn state(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// An item that was removed from a queue, and returns to it unless it is taken: the program may drop the future that waits for
/// something else before it uses the item.
pub(super) struct Popped<'a, T> {
    /// Present until it is taken.
    item: Option<T>,
    queue: &'a ReceiveQueue<T>,
}

impl<T> Popped<'_, T> {
    /// Returns the item, unless it was taken.
    pub(super) fn item(&mut self) -> Option<&mut T> {
        self.item.as_mut()
    }

    /// Takes the item, which does not return to the queue then.
    pub(super) fn take(mut self) -> Option<T> {
        self.item.take()
    }
}

impl<T> Drop for Popped<'_, T> {
    fn drop(&mut self) {
        if let Some(item) = self.item.take() {
            self.queue.put_back(item);
        }
    }
}

impl<T: Send> Sink<T> for Arc<ReceiveQueue<T>> {
    fn deliver(&self, item: T) {
        self.push(item);
    }

    fn end(&self) {
        self.close();
    }
}

/// The writing end of a queue. A callback of Zenoh owns it; dropping the callback, at the latest with the session, closes the
/// queue.
pub(super) struct QueueWriter<T>(Arc<ReceiveQueue<T>>);

impl<T> QueueWriter<T> {
    pub(super) fn new(queue: &Arc<ReceiveQueue<T>>) -> Self {
        Self(queue.clone())
    }
}

impl<T> Deref for QueueWriter<T> {
    type Target = ReceiveQueue<T>;

    fn deref(&self) -> &ReceiveQueue<T> {
        &self.0
    }
}

impl<T> Drop for QueueWriter<T> {
    fn drop(&mut self) {
        let _ = self.0.finished_on.set(thread::current().id());
        self.0.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rect_core::message::queue::WhenFull;

    #[tokio::test]
    async fn pop_wakes_on_push_and_on_close() {
        let queue = ReceiveQueue::new(Queue::new(2, WhenFull::DropOldest));
        let waiting = tokio::spawn({
            let queue = queue.clone();
            async move { (queue.pop().await, queue.pop().await) }
        });
        tokio::task::yield_now().await;
        assert!(queue.push(1));
        queue.close();
        assert_eq!(waiting.await.expect("done"), (Some(1), None));
        assert!(!queue.push(2), "closed");
    }

    #[tokio::test]
    async fn blocked_push_ends_when_there_is_room_or_on_close() {
        let queue = ReceiveQueue::new(Queue::new(1, WhenFull::Block));
        assert!(queue.push(1));
        let pushing = |n| {
            let queue = queue.clone();
            tokio::task::spawn_blocking(move || queue.push(n))
        };
        let second = pushing(2);
        assert_eq!(queue.pop().await, Some(1));
        assert!(second.await.expect("no panic"));
        let third = pushing(3);
        queue.close();
        assert!(!third.await.expect("no panic"));
        assert_eq!(queue.pop().await, Some(2), "queued items remain readable");
        assert_eq!(queue.pop().await, None);
    }
}
