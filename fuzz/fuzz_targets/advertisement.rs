//! Whatever a stranger advertises under our UUID.
#![no_main]
use libfuzzer_sys::fuzz_target;
use zenoh_link_ble::advertisement::Advertisement;

fuzz_target!(|data: &[u8]| {
    if let Ok(advertisement) = Advertisement::decode(data) {
        assert_eq!(
            Advertisement::decode(&advertisement.encode()),
            Ok(advertisement)
        );
    }
});
