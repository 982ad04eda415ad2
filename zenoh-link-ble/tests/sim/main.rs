//! Tests links on the simulated air, in virtual time: `cargo test -p zenoh-link-ble --test sim`.
//!
//! `link_contract` is the contract that `contract_bluez.rs` runs on BlueZ, too. `faults` cuts links after every packet, and has peers
//! that leave or stall; `endurance` ends ten thousand links and runs for a day; `hall` has 45 robots; in `rejected_peers`, some robots
//! do not have the team's secret. The last three are faster with `--profile quick`.
#[path = "../contract/mod.rs"]
#[macro_use]
mod contract;
mod endurance;
mod faults;
mod hall;
mod link_contract;
mod rejected_peers;
#[path = "../shared"]
mod shared {
    pub mod hall;
    pub mod heap;
    pub mod listener;
    pub mod pair;
    pub mod peer;
    pub mod raw;
    pub mod sealed;
}
