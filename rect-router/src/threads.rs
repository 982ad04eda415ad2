//! Owns how many threads Zenoh's runtimes have. A message that has to wait for room occupies a thread of `rx`: one for each
//! connection of a program that publishes more than a Bluetooth link carries, and one for each program that does not read
//! and each priority. When all of them wait, the router reads nothing from anybody, urgent messages included. A program
//! that has stopped is let go in a thread of `tx`, which waits until the former gives up
//! (`tests/upstream/stopped_reader.py`). With Zenoh's own 2 and 1 that stops the whole router. A thread that has nothing to
//! do costs 17 kB of memory.
use std::env;

/// Zenoh reads its threads from here only, once, when it starts the first.
const VARIABLE: &str = "ZENOH_RUNTIME";
const THREADS: &str = "(rx: (worker_threads: 32), tx: (worker_threads: 4))";

/// Before anything of Zenoh runs, and any other thread. What the user has set stays.
pub fn set() {
    if env::var_os(VARIABLE).is_none() {
        env::set_var(VARIABLE, THREADS);
    }
}
