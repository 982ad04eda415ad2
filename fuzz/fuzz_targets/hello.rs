//! Whatever a peer sends first: an opening that reads, writes back to one that reads the same, and a proof that is made
//! without the secret is none. Each input is tried as a whole SDU and as the body of every kind of message.
#![no_main]
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use zenoh_link_ble::{
    hello::{Challenge, NodeId, Opening, MAGIC, MAX_SIZE},
    secret::{Proof, Said, Secret, Side, NONCE_BYTES},
};

/// HELLO, ACCEPT, REFUSE, CHALLENGE, PROOF, and one that does not exist.
const KINDS: std::ops::RangeInclusive<u8> = 1..=6;
/// Before the body of a challenge or a proof: magic, kind, version.
const HEAD: usize = MAGIC.len() + 2;

static SECRET: LazyLock<Secret> =
    LazyLock::new(|| Secret::new(b"what only the team knows").expect("long enough"));

fuzz_target!(|input: &[u8]| {
    check(input);
    for kind in KINDS {
        check(&[&MAGIC[..], &[kind], input].concat());
    }
});

fn check(sdu: &[u8]) {
    let Ok(opening) = Opening::decode(sdu) else {
        return;
    };
    assert!(sdu.len() <= MAX_SIZE);
    let encoded = opening.encode();
    match &opening {
        Opening::Challenge(challenge) => {
            assert_eq!(sdu[HEAD..encoded.len()], encoded[HEAD..]);
            check_challenge(challenge);
        }
        Opening::Proof(proof) => {
            assert_eq!(sdu[HEAD..encoded.len()], encoded[HEAD..]);
            check_proof(proof, sdu);
        }
        Opening::Hello(_) | Opening::Accept(_) | Opening::Refuse(_) => {}
    }
    assert_eq!(Opening::decode(&encoded), Ok(opening));
}

/// As the dialler looks at it.
fn check_challenge(challenge: &Challenge) {
    let said = Said {
        hello: b"a hello",
        listener: challenge.node,
        nonce: &challenge.nonce,
    };
    assert!(!SECRET.is_proved(Side::Listener, said, &challenge.proof));
    // And the right one, changed nowhere on its way.
    let proof = SECRET.proof(Side::Listener, said);
    let honest = Opening::Challenge(Challenge {
        proof,
        ..challenge.clone()
    });
    match Opening::decode(&honest.encode()) {
        Ok(Opening::Challenge(read)) => {
            assert!(SECRET.is_proved(Side::Listener, said, &read.proof));
        }
        other => panic!("{other:?}"),
    }
}

/// As the listener looks at it, whatever the hello before it was.
fn check_proof(proof: &Proof, hello: &[u8]) {
    let said = Said {
        hello,
        listener: NodeId(1),
        nonce: &[7; NONCE_BYTES],
    };
    assert!(!SECRET.is_proved(Side::Dialler, said, proof));
    // What one side proves with proves nothing for the other.
    let right = SECRET.proof(Side::Dialler, said);
    assert!(SECRET.is_proved(Side::Dialler, said, &right));
    assert!(!SECRET.is_proved(Side::Listener, said, &right));
}
