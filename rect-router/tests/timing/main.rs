//! Tests that measure time. Nothing should run beside them, so that their bounds are fair; `make test` runs them
//! alone, one after the other: `cargo test -p rect-router --test timing -- --test-threads 1`

#[path = "../support/mod.rs"]
mod support;

mod flood;
mod limits;
mod stream;
mod transfer;
mod urgency;
