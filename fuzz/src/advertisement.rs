//! Decodes untrusted advertisements. A decoded advertisement must encode to the same value.
use zenoh_link_ble_radio::advertisement::Advertisement;

/// Runs the target on one input.
pub fn run(data: &[u8]) {
    if let Ok(advertisement) = Advertisement::decode(data) {
        assert_eq!(
            Advertisement::decode(&advertisement.encode()),
            Ok(advertisement)
        );
    }
}
