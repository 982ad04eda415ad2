//! Tests a contest hall full of robots, on the simulated air in virtual time:
//! `cargo test -p zenoh-link-ble --profile quick --test hall_sim -- --nocapture`.
mod shared {
    pub mod hall;
    pub mod peer;
}
mod hall;
