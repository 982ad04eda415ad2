//! Tests that many reconnects and a day of faults leak no resources:
//! `cargo test -p zenoh-link-ble --profile quick --test sim endurance -- --nocapture`.
mod day;
mod reconnects;
