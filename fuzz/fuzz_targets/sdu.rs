//! Whatever a peer sends on an open link: with its check put right, it is refused or writes back the same.
#![no_main]
use libfuzzer_sys::fuzz_target;
use zenoh_link_ble::lanes::{
    piece::Piece,
    sdu::{open, seal},
};

fuzz_target!(|sdu: &[u8]| {
    let _ = open(0, sdu);
    let _ = Piece::of(sdu);
    let mut sdu = sdu.to_vec();
    seal(7, &mut sdu);
    if let Ok(content) = open(7, &sdu) {
        let mut written = content.encode();
        seal(7, &mut written);
        assert_eq!(written, sdu);
    }
});
