//! Replaces the published crate `zenoh-link` 1.10.2: all links of Zenoh, and `ble/`.
//!
//! It is for programs that do not register links themselves: a stock `zenohd`, or a program outside this workspace that
//! dials `ble/`. Such a build contains
//!
//! ```toml
//! [patch.crates-io]
//! zenoh-link = { path = "/path/to/rect/crates/zenoh-link-with-ble" }
//! ```
//!
//! The programs of this repository use the drop-in `crates/zenoh-link` instead, and register their links.

pub use zenoh_link_table::*;
