//! Decodes untrusted handshake messages. A decoded message must encode to the same value, and a key that was made without
//! the secret must be rejected. Each input is tried as a whole SDU and as the body of every kind of message.
use std::sync::LazyLock;

use link_lanes::{hello::{HandshakeMessage, Key, MAGIC, MAX_SIZE, VERSION}, key_agreement::{respond, Initiator}, secret::Secret};

/// HELLO, ACCEPT, REFUSE, KEY, KEY ANSWER, and an unknown kind.
const KINDS: std::ops::RangeInclusive<u8> = 1..=6;
/// Bytes before the message of a key: magic, kind, version.
const HEADER_BYTES: usize = MAGIC.len() + 2;

static SECRET: LazyLock<Secret> =
    LazyLock::new(|| Secret::new(b"what only the team knows").expect("long enough"));

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    check(input);
    for kind in KINDS {
        check(&[&MAGIC[..], &[kind], input].concat());
    }
}

fn check(sdu: &[u8]) {
    let Ok(message) = HandshakeMessage::decode(sdu) else {
        return;
    };
    assert!(sdu.len() <= MAX_SIZE);
    let encoded = message.encode();
    match &message {
        HandshakeMessage::Key(key) => {
            assert_eq!(sdu[HEADER_BYTES..encoded.len()], encoded[HEADER_BYTES..]);
            // A listener answers any key. Its sender cannot seal anything with it.
            let _ = respond(&SECRET, &Key::header(key.version), &key.message);
        }
        HandshakeMessage::KeyAnswer(key) => {
            assert_eq!(sdu[HEADER_BYTES..encoded.len()], encoded[HEADER_BYTES..]);
            let started = Initiator::start(&SECRET, &Key::header(VERSION));
            let (initiator, _) = started.expect("starts");
            assert!(initiator.finish(&key.message).is_err());
        }
        HandshakeMessage::Hello(_) | HandshakeMessage::Accept(_) | HandshakeMessage::Refuse(_) => {}
    }
    assert_eq!(HandshakeMessage::decode(&encoded), Ok(message));
}
