//! Registers the links that the router adds to Zenoh's.
use std::sync::Arc;

use zenoh_link_placeholder::{LinkManagerUnicastPlaceholder, PLACEHOLDER_LOCATOR_PREFIX};
use zenoh_link_table::RegisteredLink;

/// Registers `ble/`, `any/` and `placeholder/`. Must be called before Zenoh is opened; further calls have no effect.
pub fn register() {
    rect_links::register();
    zenoh_link_table::register(RegisteredLink {
        prefix: PLACEHOLDER_LOCATOR_PREFIX,
        is_reliable: true,
        // Placeholders accept no links.
        is_gated: false,
        // The links are those of the real protocols, by their managers.
        opens_links: false,
        make: |new_links| Arc::new(LinkManagerUnicastPlaceholder::new(new_links)),
    });
}
