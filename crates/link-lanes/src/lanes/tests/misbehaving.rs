//! A peer with the right checks or keys violates the protocol.
use std::convert::Infallible;

use super::{lane, sent, Pair, MTU, WINDOW};
use crate::lanes::{
    credits::{cost, CreditError},
    receiver::Violation,
    sdu::{Content, Protection, Sealer},
    Change,
};

/// A peer that sends any content, with correct checks.
struct MisbehavingPeer {
    pair: Pair,
    sealer: Sealer,
}

impl MisbehavingPeer {
    fn new() -> Self {
        Self {
            pair: Pair::new(),
            sealer: Protection::checks().out,
        }
    }

    fn sends(&mut self, content: Content<'_>) -> Result<Change, Violation> {
        let mut sdu = content.encode();
        let Ok(_) = self.sealer.seal(&mut sdu, |_| Ok::<_, Infallible>(true));
        self.pair.receiver.on_sdu(&mut sdu, self.pair.now)
    }
}

#[test]
fn peer_that_ignores_its_credits_is_detected_within_the_window() {
    let mut peer = MisbehavingPeer::new();
    let batch = Content::Batch(lane(3), &[0; MTU]);
    let sent = std::iter::from_fn(|| peer.sends(batch).ok()).count();
    assert_eq!(sent, usize::from(WINDOW / cost(MTU)));
    let expected = Err(Violation::Credits(CreditError::Overrun));
    assert_eq!(peer.sends(batch), expected);
}

/// Batches that the receiver has acknowledged no longer count, even if the peer has not read the acknowledgement. Unread
/// lanes are bounded separately.
#[test]
fn receiver_that_has_acknowledged_cannot_detect_an_overrun() {
    let mut peer = MisbehavingPeer::new();
    for n in 0..10 * (WINDOW / cost(MTU)) {
        let change = peer.sends(Content::Batch(lane(3), &[0; MTU]));
        assert_eq!(change, Ok(Change::Batch(lane(3))), "batch {n}");
        assert!(peer.pair.take(3).is_some());
        while sent(&mut peer.pair.receiver, peer.pair.now).is_some() {}
    }
}

#[test]
fn peer_that_keeps_sending_on_a_stopped_lane_is_detected() {
    let mut peer = MisbehavingPeer::new();
    let batch = Content::Batch(lane(3), &[0; MTU]);
    let mut held = 0;
    let violation = loop {
        // The peer gets its acknowledgements and ignores all other signals.
        while sent(&mut peer.pair.receiver, peer.pair.now).is_some() {}
        match peer.sends(batch) {
            Ok(_) => held += MTU,
            Err(violation) => break violation,
        }
        assert!(held < 100_000, "memory is bounded");
    };
    assert_eq!(violation, Violation::Stopped(lane(3)));
}

#[test]
fn acknowledgement_of_more_than_was_sent_is_detected() {
    let mut peer = MisbehavingPeer::new();
    let expected = Err(Violation::Credits(CreditError::ExceedsSent));
    assert_eq!(peer.sends(Content::Ack(1)), expected);
}

#[test]
fn sdu_over_the_mtu_ends_the_link() {
    let mut peer = MisbehavingPeer::new();
    let (size, mtu) = (MTU + 1, MTU);
    let expected = Err(Violation::TooLarge { size, mtu });
    assert_eq!(peer.sends(Content::Batch(lane(3), &[0; MTU + 1])), expected);
}
