//! Whatever a peer sends first: an opening that reads, writes back to one that reads the same.
#![no_main]
use libfuzzer_sys::fuzz_target;
use zenoh_link_ble::hello::{Opening, MAX_SIZE};

fuzz_target!(|sdu: &[u8]| {
    if let Ok(opening) = Opening::decode(sdu) {
        assert!(sdu.len() <= MAX_SIZE);
        assert_eq!(Opening::decode(&opening.encode()), Ok(opening));
    }
});
