//! A Zenoh link whose peer is chosen, changed and removed while the router runs.
//!
//! Zenoh reads the endpoints that it connects to once, when it starts. A program adds the endpoints of a [`Placeholders`]
//! table to them. Zenoh then keeps dialling every placeholder: the dial waits while the placeholder is empty, and Zenoh
//! dials again after a link has ended. A placeholder that is set dials its current [`Dial`]; the resulting link is a link of
//! the real protocol. Closing a link whose placeholder has changed is the responsibility of the code that opened it.
mod manager;
mod placeholders;

pub use manager::LinkManagerUnicastPlaceholder;
pub use placeholders::{Dial, Placeholders};

/// The name of the protocol in a locator: `placeholder/<table>.<number>`.
pub const PLACEHOLDER_LOCATOR_PREFIX: &str = "placeholder";
