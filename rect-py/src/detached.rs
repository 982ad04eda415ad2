//! Releases Python's global interpreter lock (GIL) during native work, and waits for such work before Python exits.
//!
//! When Python exits, it unwinds each thread that requests the GIL. Unwinding through Rust would abort the process.
use std::{
    sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst},
    thread,
    time::{Duration, Instant},
};

use pyo3::prelude::*;

/// Whether Python is about to exit. If so, native work keeps the GIL.
static IS_ENDING: AtomicBool = AtomicBool::new(false);
/// Number of threads that do native work without the GIL, or wait to acquire it again afterwards.
static WORKING: AtomicUsize = AtomicUsize::new(0);
/// Interval at which [`settle`] checks for work.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Counts a thread in [`WORKING`] while the value exists.
struct Working;

impl Working {
    fn begin() -> Self {
        WORKING.fetch_add(1, SeqCst);
        Self
    }
}

impl Drop for Working {
    fn drop(&mut self) {
        // A forked child process has reset the count, so it must not fall below zero.
        let decrement = |working: usize| working.checked_sub(1);
        let _ = WORKING.fetch_update(SeqCst, SeqCst, decrement);
    }
}

/// Runs `work` without the GIL, unless Python is about to exit.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> T {
    if IS_ENDING.load(SeqCst) {
        return work();
    }
    let _working = Working::begin();
    py.detach(work)
}

/// Runs `work` with the GIL, on a thread that Python does not know, unless Python is about to exit.
pub fn attached(work: impl FnOnce(Python<'_>)) {
    let _working = Working::begin();
    if !IS_ENDING.load(SeqCst) {
        Python::attach(work);
    }
}

/// Prepares for the exit of Python: makes all later work keep the GIL, and waits until no thread does native work
/// without it, for at most `timeout_s` seconds.
#[pyfunction]
pub fn settle(py: Python<'_>, timeout_s: f64) {
    IS_ENDING.store(true, SeqCst);
    let deadline = Instant::now() + Duration::try_from_secs_f64(timeout_s).unwrap_or_default();
    while WORKING.load(SeqCst) > 0 && Instant::now() < deadline {
        py.detach(|| thread::sleep(POLL_INTERVAL));
    }
}

/// Resets the count of working threads in a forked child process, which has none of its parent's threads.
#[pyfunction]
pub fn forget_work() {
    WORKING.store(0, SeqCst);
}
