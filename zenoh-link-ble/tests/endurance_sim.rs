//! Tests that many reconnects and a day of faults leak no resources, on the simulated air in virtual time:
//! `cargo test -p zenoh-link-ble --profile quick --test endurance_sim -- --nocapture`.
mod endurance {
    mod day;
    mod reconnects;
}
mod shared {
    pub mod heap;
    pub mod pair;
    pub mod peer;
}
