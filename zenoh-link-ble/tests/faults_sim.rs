//! Tests links during failures of the radio contact, of an adapter or of a peer, on the simulated air in virtual time:
//! `cargo test -p zenoh-link-ble --test faults_sim`.
mod faults {
    mod conversation;
    mod cuts;
    mod intervals;
    mod peer_loss;
    mod stalled;
}
mod shared {
    pub mod heap;
    pub mod listener;
    pub mod pair;
    pub mod peer;
    pub mod raw;
}
