//! Replaces the published crate `zenoh-link` 1.10.2: all links of Zenoh, and those that a program registers.
//!
//! Zenoh's links are a closed enum (zenoh#2707). A new link is possible only if this crate takes the place of the
//! published one: `[patch.crates-io] zenoh-link = { path = "crates/zenoh-link" }`. All public items of the published crate
//! exist here with the same names; `tests/` checks this. The crate `zenoh-link-table` contains the code, so that both
//! drop-ins share it: this one, which knows no link of RECT's, and `zenoh-link-with-ble`.

pub use zenoh_link_table::*;
