//! Converts between the clock of a computer and the time since 1970, which the wire and files carry.
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Returns the time from 1970 (UTC) to `at`; 0 if `at` is earlier.
pub fn since_1970(at: SystemTime) -> Duration {
    at.duration_since(UNIX_EPOCH).unwrap_or_default()
}

/// Returns the milliseconds from 1970 (UTC) to `at`; 0 if `at` is earlier.
pub fn ms_since_1970(at: SystemTime) -> u64 {
    u64::try_from(since_1970(at).as_millis()).unwrap_or(u64::MAX)
}
