//! The threads of Zenoh, which it reads from an environment variable.

/// The environment variable from which Zenoh reads its threads, once, when it starts the first one.
pub const VARIABLE: &str = "ZENOH_RUNTIME";

/// The value of [`VARIABLE`] with which all work of Zenoh shares one thread.
pub const ONE_THREAD: &str = "(app: (worker_threads: 1), rx: (handover: app), acc: (handover: app), tx: (handover: app), net: (handover: app))";
