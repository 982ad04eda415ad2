//! Decodes untrusted SDUs of an open link. With a correct check value, an SDU must be rejected or encode to the same
//! bytes.
#![no_main]
use libfuzzer_sys::fuzz_target;
use zenoh_link_ble::protocol::lanes::{
    batch_kind::BatchKind,
    sdu::{open, seal},
};

fuzz_target!(|sdu: &[u8]| {
    let _ = open(0, sdu);
    let _ = BatchKind::of(sdu);
    let mut sdu = sdu.to_vec();
    seal(7, &mut sdu);
    if let Ok(content) = open(7, &sdu) {
        let mut written = content.encode();
        seal(7, &mut written);
        assert_eq!(written, sdu);
    }
});
