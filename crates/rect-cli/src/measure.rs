//! Measurements between two robots, for `rect bench` and `rect survey`.
pub mod goodput;
pub mod load;
pub mod partner;
pub mod round_trip;

use rect::Name;

use crate::Failure;

/// Adds advice to the error of a request to the other robot. `command` is what must run there.
fn not_served(other: &Name, error: &rect::Error) -> Failure {
    format!("{error}. Is `rect bench --serve` or `rect survey --serve` running on {other}?").into()
}
