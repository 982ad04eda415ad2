//! Defines the bounded queue between Zenoh's threads and the program. A full queue applies the rule that the core
//! defines. The queue wakes threads that wait for items or for room.
//!
//! Zenoh's threads fill the queue without running Python code, which would cost more than all their other work.
use std::{
    collections::VecDeque,
    sync::{Condvar, Mutex, MutexGuard, PoisonError},
    thread::{self, ThreadId},
};

use pyo3::{create_exception, exceptions::PyException, intern, prelude::*};
use rect_core::message::queue::{self, Pushed, WhenFull};

use crate::errors::raised;

create_exception!(
    rect._rect,
    Ended,
    PyException,
    "The queue is closed and empty."
);

/// Items that wait for a program.
#[pyclass(frozen, module = "rect._rect")]
pub struct Queue {
    state: Mutex<State>,
    has_room: Condvar,
}

struct State {
    queue: queue::Queue<Py<PyAny>>,
    /// The locks that waiting threads try to acquire, one for each; releasing a lock wakes its thread. The thread that
    /// has waited longest comes first.
    waiting: VecDeque<Py<PyAny>>,
    /// Number of threads that wait for room. If it is 0, the system call that wakes them is omitted.
    waiting_for_room: usize,
    /// Function to call when an item is added or the queue is closed.
    alarm: Option<Py<PyAny>>,
    /// Whether further items are rejected.
    is_closed: bool,
    /// The thread on which the side that fills the queue has closed it.
    finished_on: Option<ThreadId>,
}

#[pymethods]
impl Queue {
    /// Creates a queue. `when_full` is `drop_oldest`, `drop_newest` or `block`. Raises `OptionError` for other values.
    #[new]
    fn new(py: Python<'_>, capacity: usize, when_full: &str) -> PyResult<Self> {
        let when_full = match when_full {
            "drop_oldest" => WhenFull::DropOldest,
            "drop_newest" => WhenFull::DropNewest,
            "block" => WhenFull::Block,
            _ => {
                let expected = "it must be \"drop_oldest\", \"drop_newest\" or \"block\"";
                return Err(raised(
                    py,
                    "OptionError",
                    ("when_full", when_full, expected),
                ));
            }
        };
        let state = State {
            queue: queue::Queue::new(capacity, when_full),
            waiting: VecDeque::new(),
            waiting_for_room: 0,
            alarm: None,
            is_closed: false,
            finished_on: None,
        };
        Ok(Self {
            state: Mutex::new(state),
            has_room: Condvar::new(),
        })
    }

    /// Adds an item. If the queue is full and its rule is `block`, waits for room. Returns `False` if the item was
    /// dropped, because the queue is full or closed.
    pub fn push(&self, py: Python<'_>, item: Py<PyAny>) -> PyResult<bool> {
        let mut item = item;
        // Dropping an item may run Python code, so it happens after the lock is released.
        let (kept, _dropped) = loop {
            let mut state = self.state();
            if state.is_closed {
                break (false, Some(item));
            }
            match state.queue.push(item) {
                Pushed::Kept => break (true, None),
                Pushed::DroppedOldest(oldest) => break (true, Some(oldest)),
                Pushed::DroppedNewest(newest) => break (false, Some(newest)),
                Pushed::Full(back) => item = back,
            }
            drop(state);
            py.detach(|| self.wait_for_room());
        };
        if kept {
            self.wake(py)?;
        }
        Ok(kept)
    }

    /// Does the same as `push`, as a callback of Zenoh.
    fn __call__(&self, py: Python<'_>, item: Py<PyAny>) -> PyResult<()> {
        self.push(py, item).map(|_| ())
    }

    /// Removes and returns the oldest item. If there is none, returns `None` and keeps `lock`, which the caller must
    /// have acquired; the queue releases it when an item is added. Raises `Ended` if the queue is closed and empty.
    #[pyo3(signature = (lock=None))]
    fn pop(&self, lock: Option<Py<PyAny>>) -> PyResult<Option<Py<PyAny>>> {
        let mut state = self.state();
        let item = state.queue.pop();
        if item.is_some() {
            if state.waiting_for_room > 0 {
                self.has_room.notify_one();
            }
        } else if state.is_closed {
            return Err(Ended::new_err(()));
        } else {
            state.waiting.extend(lock);
        }
        Ok(item)
    }

    /// Wakes the thread that has waited longest, and calls the alarm.
    fn wake(&self, py: Python<'_>) -> PyResult<()> {
        let mut state = self.state();
        let first = state.waiting.pop_front();
        let alarm = state.alarm.as_ref().map(|alarm| alarm.clone_ref(py));
        drop(state);
        if let Some(lock) = first {
            lock.call_method0(py, intern!(py, "release"))?;
        }
        if let Some(alarm) = alarm {
            alarm.call0(py)?;
        }
        Ok(())
    }

    /// Removes a lock that `pop` has kept. Returns `False` if it was released already.
    fn leave(&self, lock: &Bound<'_, PyAny>) -> bool {
        let mut state = self.state();
        let at = state.waiting.iter().position(|waiting| waiting.is(lock));
        at.is_some_and(|at| state.waiting.remove(at).is_some())
    }

    /// Sets the function to call when an item is added or the queue is closed; `None` for none.
    fn set_alarm(&self, alarm: Option<Py<PyAny>>) {
        let _before = std::mem::replace(&mut self.state().alarm, alarm);
    }

    /// Closes the queue to new items. Items that are waiting can still be taken.
    pub fn close(&self, py: Python<'_>) -> PyResult<()> {
        let waiting = {
            let mut state = self.state();
            state.is_closed = true;
            state.waiting.len()
        };
        self.has_room.notify_all();
        (0..waiting.max(1)).try_for_each(|_| self.wake(py))
    }

    /// Closes the queue after its last item. Called by the side that fills the queue.
    fn end(&self, py: Python<'_>) -> PyResult<()> {
        self.state().finished_on = Some(thread::current().id());
        self.close(py)
    }

    /// Whether the side that fills the queue has closed it.
    #[getter]
    fn is_finished(&self) -> bool {
        self.state().finished_on.is_some()
    }

    /// Whether it has done so on this thread.
    #[getter]
    fn is_finished_here(&self) -> bool {
        self.state().finished_on == Some(thread::current().id())
    }

    /// Number of items dropped because the queue was full.
    #[getter]
    fn dropped(&self) -> u64 {
        self.state().queue.dropped()
    }

    fn __len__(&self) -> usize {
        self.state().queue.len()
    }
}

impl Queue {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait_for_room(&self) {
        let mut state = self.state();
        state.waiting_for_room += 1;
        let has_no_room = |state: &mut State| state.queue.must_wait() && !state.is_closed;
        let state = self.has_room.wait_while(state, has_no_room);
        state
            .unwrap_or_else(PoisonError::into_inner)
            .waiting_for_room -= 1;
    }
}
