//! Parses untrusted locators of a user, a file or a peer. An accepted locator must respect the limits of its options.
use zenoh_link_ble::locator::{ConnectLocator, ListenLocator};
use zenoh_protocol::core::EndPoint;

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else {
        return;
    };
    let Ok(endpoint) = format!("ble/{text}").parse::<EndPoint>() else {
        return;
    };
    if let Ok(locator) = ConnectLocator::parse(&endpoint) {
        assert!(locator.mtu >= 128);
    }
    if let Ok(locator) = ListenLocator::parse(&endpoint) {
        assert!(locator.max_links >= 1 && !locator.name().is_empty());
    }
}
