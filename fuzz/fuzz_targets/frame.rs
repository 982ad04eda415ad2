//! Whatever a peer sends on an open link.
#![no_main]
use libfuzzer_sys::fuzz_target;
use zenoh_link_ble::frame::Frame;

fuzz_target!(|sdu: &[u8]| {
    if let Ok(frame) = Frame::decode(sdu) {
        let written = frame.encode();
        assert_eq!(Frame::decode(&written), Ok(frame));
    }
});
