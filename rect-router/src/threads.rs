//! Owns how many threads Zenoh's runtimes have. Zenoh waits for room on the way to a program that does not read in a thread
//! of `rx`, one for each such program and priority, and lets a stopped one go in a thread of `tx`, which waits until the
//! former gives up (`tests/upstream/stopped_reader.py`). With Zenoh's own 2 and 1 that stops the whole router.
use std::env;

/// Zenoh reads its threads from here only, once, when it starts the first.
const VARIABLE: &str = "ZENOH_RUNTIME";
const THREADS: &str = "(rx: (worker_threads: 4), tx: (worker_threads: 4))";

/// Before anything of Zenoh runs, and any other thread. What the user has set stays.
pub fn set() {
    if env::var_os(VARIABLE).is_none() {
        env::set_var(VARIABLE, THREADS);
    }
}
