//! Releases Python's lock during native work, and sees to it that no thread is in such work when Python ends. A thread that
//! asks for the lock back at that time is unwound by Python, through Rust, which aborts the process.
use std::{
    sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst},
    thread,
    time::{Duration, Instant},
};

use pyo3::prelude::*;

/// Python is about to end: the lock is not released any more.
static IS_ENDING: AtomicBool = AtomicBool::new(false);
/// How many threads are in native work, or wait for the lock after it.
static WORKING: AtomicUsize = AtomicUsize::new(0);
const GLANCE: Duration = Duration::from_millis(1);

struct Working;

impl Working {
    fn begin() -> Self {
        WORKING.fetch_add(1, SeqCst);
        Self
    }
}

impl Drop for Working {
    fn drop(&mut self) {
        // A child process counts anew.
        let less = |working: usize| working.checked_sub(1);
        let _ = WORKING.fetch_update(SeqCst, SeqCst, less);
    }
}

/// Does `work` without Python's lock.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> T {
    if IS_ENDING.load(SeqCst) {
        return work();
    }
    let _working = Working::begin();
    py.detach(work)
}

/// For the end of Python: waits, up to that many seconds, until no thread is in native work; none begins any more.
#[pyfunction]
pub fn settle(py: Python<'_>, timeout_s: f64) {
    IS_ENDING.store(true, SeqCst);
    let deadline = Instant::now() + Duration::try_from_secs_f64(timeout_s).unwrap_or_default();
    while WORKING.load(SeqCst) > 0 && Instant::now() < deadline {
        py.detach(|| thread::sleep(GLANCE));
    }
}

/// For a child process, which has none of its parent's threads.
#[pyfunction]
pub fn forget_work() {
    WORKING.store(0, SeqCst);
}
