//! Decodes untrusted advertisements. A decoded advertisement must encode to the same value.
#![no_main]
use libfuzzer_sys::fuzz_target;
use zenoh_link_ble_radio::advertisement::Advertisement;

fuzz_target!(|data: &[u8]| {
    if let Ok(advertisement) = Advertisement::decode(data) {
        assert_eq!(
            Advertisement::decode(&advertisement.encode()),
            Ok(advertisement)
        );
    }
});
