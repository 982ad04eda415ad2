//! Sets the number of threads of Zenoh's runtimes.
//!
//! A message that waits for room in a queue occupies a thread of `rx`: one for each session of a program that publishes more
//! than a Bluetooth link carries, and one for each priority of a program that does not read. When all of these threads wait,
//! the router reads nothing more, not even urgent messages. Closing the session of a stopped program takes a thread of `tx`,
//! which waits until the waiting thread of `rx` gives up (`tests/upstream/stopped_reader.py`). With Zenoh's defaults of 2
//! and 1 threads that stops the whole router. An idle thread costs 17 kB of memory.
use std::env;

use rect_core::session::threads::{ONE_THREAD, VARIABLE};

const THREADS: &str = "(rx: (worker_threads: 32), tx: (worker_threads: 4))";

/// Sets the number of threads unless the user has set it. Call it before any other thread runs and before Zenoh is used.
///
/// A program that uses one thread passes its choice on to a router that it starts. It is none for a router.
pub fn set() {
    if env::var_os(VARIABLE).is_none_or(|chosen| chosen == ONE_THREAD) {
        env::set_var(VARIABLE, THREADS);
    }
}
