//! A Zenoh link over several paths at once, Bluetooth and TCP: `any/<robot>#<options>`. It survives the loss of each.
//!
//! [`multipath::Multipath`] makes all decisions, without I/O, and is given the time. `PROTOCOL.md` in this crate specifies
//! what travels on the paths.
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used))]
pub mod batch_length;
mod connect;
mod connection;
mod error;
pub mod frame;
mod hub;
pub mod in_lane;
mod link;
pub mod locator;
mod manager;
pub mod meeting;
pub mod multipath;
mod network_events;
mod networks;
pub mod observers;
pub mod offer;
mod out_lane;
pub mod path;
mod proof;
mod ranges;
pub mod rtt;
mod run;
mod shared;
pub mod status;
#[cfg(test)]
mod vectors;
pub mod wifi;

pub use error::AnyError;
pub use link::INTERFACE;
pub use locator::ANY_LOCATOR_PREFIX;
pub use manager::LinkManagerUnicastAny;
