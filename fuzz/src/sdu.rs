//! Decodes untrusted SDUs of an open link. With a correct check value, an SDU must be rejected or encode to the same
//! bytes. Without the keys, nothing opens.
use std::convert::Infallible;

use link_lanes::{lanes::{batch_kind::BatchKind, sdu::Protection}, seal::LinkKeys};

/// Runs the target on one input.
pub fn run(sdu: &[u8]) {
    let _ = Protection::checks().into.open(&mut sdu.to_vec());
    let _ = BatchKind::of(sdu);
    let keys = |own, of_peer| Protection::keys(LinkKeys::new([own; 32], [of_peer; 32]));
    assert!(keys(1, 2).into.open(&mut sdu.to_vec()).is_err());
    for (mut one, mut other) in [
        (Protection::checks(), Protection::checks()),
        (keys(1, 2), keys(2, 1)),
    ] {
        let mut sealed = sdu.to_vec();
        let Ok(_) = one.out.seal(&mut sealed, |_| Ok::<_, Infallible>(true));
        if let Ok(content) = other.into.open(&mut sealed) {
            assert_eq!(content.encode(), sdu);
        }
    }
}
