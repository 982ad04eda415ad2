//! Registers RECT's links with Zenoh: `ble/` (Bluetooth LE) and `any/` (Bluetooth and TCP at once).
//!
//! Programs call [`register`] before they open Zenoh. A library does not: it leaves the choice of links to the program.
use std::sync::Arc;

use zenoh_link_any::{LinkManagerUnicastAny, ANY_LOCATOR_PREFIX};
use zenoh_link_ble::{LinkManagerUnicastBle, BLE_LOCATOR_PREFIX};
use zenoh_link_table::RegisteredLink;

/// Registers `ble/` and `any/`. Must be called before `zenoh::open`; further calls have no effect.
///
/// The build must replace the crate `zenoh-link` by RECT's drop-in, through `[patch.crates-io]`. Otherwise, Zenoh does not use
/// the registered links.
pub fn register() {
    zenoh_link_table::succession::enable();
    zenoh_link_table::register(RegisteredLink {
        prefix: BLE_LOCATOR_PREFIX,
        is_reliable: true,
        // The radio limits its links itself; they must be accepted even if all other sessions are in use.
        is_gated: false,
        opens_links: true,
        make: |new_links| Arc::new(LinkManagerUnicastBle::new(new_links)),
    });
    zenoh_link_table::register(RegisteredLink {
        prefix: ANY_LOCATOR_PREFIX,
        is_reliable: true,
        // Its Bluetooth links are limited by the radio, and a connection over TCP needs the secret of the team.
        is_gated: false,
        opens_links: true,
        make: |new_links| Arc::new(LinkManagerUnicastAny::new(new_links)),
    });
}
