//! A Zenoh link over Bluetooth Low Energy: `ble/<address or name>#<options>`.
//!
//! Each Zenoh batch is sent as one SDU of an LE L2CAP connection-oriented channel. The crate `link-lanes` specifies and
//! implements the wire protocol, `zenoh-link-ble-radio` defines the interface of a radio, and two crates implement it:
//! `zenoh-link-ble-bluez` for the Bluetooth stack of Linux, and `zenoh-link-ble-air` for the simulated air.
//!
//! Zenoh uses this crate through [`LinkManagerUnicastBle`], which dials and accepts links.
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used))]
mod adapter;
mod connections;
mod dialer;
mod discovered;
mod error;
mod handshake;
mod link;
mod listener;
pub mod locator;
mod manager;
mod name_conflict;
mod pending_handshakes;
mod refusals;
mod rejected_peers;
mod scanner;
pub mod secret_file;
pub mod status;

pub use error::{BleError, DialStep};
pub use link::path;
pub use link::table::LinkCounts;
pub use locator::BLE_LOCATOR_PREFIX;
pub use manager::{Identity, LinkManagerUnicastBle};
