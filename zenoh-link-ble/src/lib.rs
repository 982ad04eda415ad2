//! A Zenoh link over Bluetooth Low Energy: `ble/<address or name>#<options>`.
//!
//! Each Zenoh batch is sent as one SDU of an LE L2CAP connection-oriented channel. The wire format is defined in
//! `PROTOCOL.md` in this crate and implemented by [`advertisement`] and `protocol`.
//!
//! Zenoh uses this crate through [`LinkManagerUnicastBle`]. A radio is attached through [`radio::Radio`].
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used))]
mod adapter;
pub mod address;
pub mod advertisement;
mod dialer;
mod discovered;
mod error;
mod handshake;
pub mod interval;
mod link;
mod listener;
pub mod locator;
mod manager;
mod name_conflict;
mod node_id;
mod pending_handshakes;
#[doc(hidden)]
pub mod protocol;
pub mod radio;
mod rejected_peers;
mod scanner;
pub mod status;

pub use error::{BleError, DialStep};
pub use link::path;
pub use link::table::LinkCounts;
pub use locator::BLE_LOCATOR_PREFIX;
pub use manager::{BleLocatorInspector, Identity, LinkManagerUnicastBle};
