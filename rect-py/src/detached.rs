//! Releases Python's global interpreter lock (GIL) during native work, and waits for such work before Python exits.
//!
//! Python unwinds a thread that requests the GIL during its exit. Unwinding through Rust would abort the process.
use std::{
    sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst},
    thread,
    time::{Duration, Instant},
};

use pyo3::prelude::*;

/// Whether Python is about to exit. From then on the GIL is not released any more.
static IS_ENDING: AtomicBool = AtomicBool::new(false);
/// Number of threads that do native work without the GIL, or wait for it afterwards.
static WORKING: AtomicUsize = AtomicUsize::new(0);
/// Interval at which [`settle`] checks for work.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

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
        let less = |working: usize| working.checked_sub(1);
        let _ = WORKING.fetch_update(SeqCst, SeqCst, less);
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

/// Prepares for the exit of Python: waits until no thread does native work without the GIL, at most `timeout_s` seconds.
/// All later work keeps the GIL.
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
