//! Owns the queue between what comes and the program: bounded, with the core's rules for when it is full, and those who wait
//! at its ends. Zenoh's threads fill it without a line of Python, which would cost a thread that is none of Python's more
//! than all the rest.
use std::{
    collections::VecDeque,
    sync::{Condvar, Mutex, MutexGuard, PoisonError},
};

use pyo3::{create_exception, exceptions::PyException, intern, prelude::*};
use rect::core::queue::{self, Pushed, WhenFull};

use crate::errors::raised;

create_exception!(rect._rect, Ended, PyException, "Nothing comes any more.");

/// What waits for a program.
#[pyclass(frozen, module = "rect._rect")]
pub struct Queue {
    state: Mutex<State>,
    taken: Condvar,
}

struct State {
    queue: queue::Queue<Py<PyAny>>,
    /// The locks at which threads wait for something to come, held, in their order.
    waiting: VecDeque<Py<PyAny>>,
    /// How many threads wait for room: to wake nobody is a system call, too.
    waiting_for_room: usize,
    /// Called when something has come, or nothing comes any more.
    alarm: Option<Py<PyAny>>,
    is_closed: bool,
    is_over: bool,
}

#[pymethods]
impl Queue {
    #[new]
    fn new(py: Python<'_>, capacity: usize, when_full: &str) -> PyResult<Self> {
        let when_full = match when_full {
            "newest wins" => WhenFull::NewestWins,
            "oldest wins" => WhenFull::OldestWins,
            "wait" => WhenFull::Wait,
            _ => {
                let known = "it is \"newest wins\", \"oldest wins\" or \"wait\"";
                return Err(raised(py, "OptionError", ("when_full", when_full, known)));
            }
        };
        let state = State {
            queue: queue::Queue::new(capacity, when_full),
            waiting: VecDeque::new(),
            waiting_for_room: 0,
            alarm: None,
            is_closed: false,
            is_over: false,
        };
        Ok(Self {
            state: Mutex::new(state),
            taken: Condvar::new(),
        })
    }

    /// Puts one in; where the rule is to wait, once there is room. `False`: dropped, or nobody takes any more.
    pub fn push(&self, py: Python<'_>, item: Py<PyAny>) -> PyResult<bool> {
        let mut item = item;
        // What is dropped may run Python: after the lock.
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

    /// The same, as a callback of Zenoh's.
    fn __call__(&self, py: Python<'_>, item: Py<PyAny>) -> PyResult<()> {
        self.push(py, item).map(|_| ())
    }

    /// The oldest that waits; `None`: there is none yet, and the lock that was given, which is held, is released when one has
    /// come. Raises `Ended`.
    #[pyo3(signature = (lock=None))]
    fn pop(&self, lock: Option<Py<PyAny>>) -> PyResult<Option<Py<PyAny>>> {
        let mut state = self.state();
        let item = state.queue.pop();
        if item.is_some() {
            if state.waiting_for_room > 0 {
                self.taken.notify_one();
            }
        } else if state.is_closed {
            return Err(Ended::new_err(()));
        } else {
            state.waiting.extend(lock);
        }
        Ok(item)
    }

    /// Whoever waits for the longest, by its lock, is to look again.
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

    /// Does not wait any more. `False`: it was woken.
    fn leave(&self, lock: &Bound<'_, PyAny>) -> bool {
        let mut state = self.state();
        let at = state.waiting.iter().position(|known| known.is(lock));
        at.is_some_and(|at| state.waiting.remove(at).is_some())
    }

    /// What to call when something has come, or nothing comes any more; `None`: nothing.
    fn set_alarm(&self, alarm: Option<Py<PyAny>>) {
        let _before = std::mem::replace(&mut self.state().alarm, alarm);
    }

    /// Nothing comes any more; what waits can still be taken.
    pub fn close(&self, py: Python<'_>) -> PyResult<()> {
        let waiting = {
            let mut state = self.state();
            state.is_closed = true;
            state.waiting.len()
        };
        self.taken.notify_all();
        (0..waiting.max(1)).try_for_each(|_| self.wake(py))
    }

    /// The same, by whoever fills it: all has come.
    fn end(&self, py: Python<'_>) -> PyResult<()> {
        self.state().is_over = true;
        self.close(py)
    }

    /// Whether it was closed by whoever fills it.
    #[getter]
    fn is_over(&self) -> bool {
        self.state().is_over
    }

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
        let has_none = |state: &mut State| state.queue.is_full() && !state.is_closed;
        let waited = self.taken.wait_while(state, has_none);
        waited
            .unwrap_or_else(PoisonError::into_inner)
            .waiting_for_room -= 1;
    }
}
