//! A Zenoh link over Bluetooth Low Energy: `ble/<address or name>#<options>`.
//!
//! One Zenoh batch travels as one SDU of an LE L2CAP connection-oriented channel. The wire format is in
//! `PROTOCOL.md` beside this crate; [`advertisement`], [`hello`] and [`lanes`] are its three parts in code.
//!
//! Zenoh meets this crate in [`LinkManagerUnicastBle`]; a radio meets it in [`radio::Radio`].
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used))]
mod adapter;
pub mod address;
pub mod advertisement;
pub mod bye;
mod dialer;
mod ending;
mod error;
mod handshakes;
mod heard;
pub mod hello;
mod history;
pub mod lanes;
mod link;
pub mod links;
mod listener;
pub mod locator;
mod manager;
mod namesake;
mod node;
mod opening;
mod pause;
mod plain;
pub mod radio;
mod scanner;
pub mod secret;
pub mod status;
mod strangers;
mod traffic;

pub use error::BleError;
pub use locator::BLE_LOCATOR_PREFIX;
pub use manager::{BleLocatorInspector, LinkManagerUnicastBle};
