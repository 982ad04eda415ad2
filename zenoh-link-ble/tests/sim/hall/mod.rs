//! Tests a contest hall full of robots:
//! `cargo test -p zenoh-link-ble --profile quick --test sim hall -- --nocapture`.
mod crowd;
mod fleets;
