//! Tests links during failures of the radio contact, of an adapter or of a peer:
//! `cargo test -p zenoh-link-ble --test sim faults`.
mod conversation;
mod cuts;
mod intervals;
mod peer_loss;
mod stalled;
