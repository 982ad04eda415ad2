//! What links do when the air, an adapter or a peer fails, on the simulated air in virtual time:
//! `cargo test -p zenoh-link-ble --test faults_sim`.
mod faults {
    mod conversation;
    mod cuts;
    mod gone;
    mod stalled;
}
mod shared {
    pub mod heap;
    pub mod listener;
    pub mod pair;
    pub mod peer;
    pub mod raw;
}
