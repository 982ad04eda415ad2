//! Decodes untrusted handshake messages. A decoded message must encode to the same value, and a proof that was made
//! without the secret must be rejected. Each input is tried as a whole SDU and as the body of every kind of message.
#![no_main]
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use zenoh_link_ble::{
    protocol::hello::{Challenge, HandshakeMessage, NodeId, MAGIC, MAX_SIZE},
    protocol::secret::{Proof, ProofTranscript, Secret, Side, NONCE_BYTES},
};

/// HELLO, ACCEPT, REFUSE, CHALLENGE, PROOF, and an unknown kind.
const KINDS: std::ops::RangeInclusive<u8> = 1..=6;
/// Bytes before the body of a challenge or a proof: magic, kind, version.
const HEADER_BYTES: usize = MAGIC.len() + 2;

static SECRET: LazyLock<Secret> =
    LazyLock::new(|| Secret::new(b"what only the team knows").expect("long enough"));

fuzz_target!(|input: &[u8]| {
    check(input);
    for kind in KINDS {
        check(&[&MAGIC[..], &[kind], input].concat());
    }
});

fn check(sdu: &[u8]) {
    let Ok(message) = HandshakeMessage::decode(sdu) else {
        return;
    };
    assert!(sdu.len() <= MAX_SIZE);
    let encoded = message.encode();
    match &message {
        HandshakeMessage::Challenge(challenge) => {
            assert_eq!(sdu[HEADER_BYTES..encoded.len()], encoded[HEADER_BYTES..]);
            check_challenge(challenge);
        }
        HandshakeMessage::Proof(proof) => {
            assert_eq!(sdu[HEADER_BYTES..encoded.len()], encoded[HEADER_BYTES..]);
            check_proof(proof, sdu);
        }
        HandshakeMessage::Hello(_) | HandshakeMessage::Accept(_) | HandshakeMessage::Refuse(_) => {}
    }
    assert_eq!(HandshakeMessage::decode(&encoded), Ok(message));
}

/// Checks a challenge as the dialler does.
fn check_challenge(challenge: &Challenge) {
    let transcript = ProofTranscript {
        hello: b"a hello",
        listener: challenge.node,
        nonce: &challenge.nonce,
    };
    assert!(!SECRET.verify(Side::Listener, transcript, &challenge.proof));
    // A correct proof must be accepted after encoding and decoding.
    let proof = SECRET.proof(Side::Listener, transcript);
    let valid = HandshakeMessage::Challenge(Challenge {
        proof,
        ..challenge.clone()
    });
    match HandshakeMessage::decode(&valid.encode()) {
        Ok(HandshakeMessage::Challenge(read)) => {
            assert!(SECRET.verify(Side::Listener, transcript, &read.proof));
        }
        other => panic!("{other:?}"),
    }
}

/// Checks a proof as the listener does, for any hello before it.
fn check_proof(proof: &Proof, hello: &[u8]) {
    let transcript = ProofTranscript {
        hello,
        listener: NodeId(1),
        nonce: &[7; NONCE_BYTES],
    };
    assert!(!SECRET.verify(Side::Dialler, transcript, proof));
    // The proof of one side must not be valid for the other.
    let valid = SECRET.proof(Side::Dialler, transcript);
    assert!(SECRET.verify(Side::Dialler, transcript, &valid));
    assert!(!SECRET.verify(Side::Listener, transcript, &valid));
}
