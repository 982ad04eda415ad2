//! Tests of the key agreement: `cargo test -p link-lanes --lib key_agreement`
use std::convert::Infallible;

use serde::Deserialize;

use super::*;
use crate::{
    hello::{HandshakeMessage, Key, VERSION},
    vectors::bytes,
};

fn secret(text: &str) -> Secret {
    Secret::new(text.as_bytes()).expect("long enough")
}

fn header() -> [u8; 6] {
    Key::header(VERSION)
}

fn seal(keys: &mut LinkKeys, sdu: &[u8]) -> Vec<u8> {
    let mut sdu = sdu.to_vec();
    let Ok(_) = keys.sealing.seal(&mut sdu, |_| Ok::<_, Infallible>(true));
    sdu
}

#[test]
fn two_nodes_with_the_same_secret_agree_on_the_same_keys() {
    let own = secret("a secret of 16 bytes");
    let (initiator, message) = Initiator::start(&own, &header()).expect("starts");
    let (answer, mut listener) = respond(&own, &header(), &message).expect("answers");
    let mut dialler = initiator.finish(&answer).expect("the same secret");
    for text in [b"\x00one", b"\x00two"] {
        let mut there = seal(&mut dialler.keys, text);
        assert_eq!(listener.keys.opening.open(&mut there), Ok(&text[..]));
        let mut back = seal(&mut listener.keys, text);
        assert_eq!(dialler.keys.opening.open(&mut back), Ok(&text[..]));
    }
    assert_eq!(dialler.exporter.key("path"), listener.exporter.key("path"));
    assert_ne!(dialler.exporter.key("path"), dialler.exporter.key("other"));
}

#[test]
fn another_secret_header_or_message_is_detected() {
    let own = secret("a secret of 16 bytes");
    let (ours, theirs) = (header(), Key::header(VERSION + 1));
    for (listener, seen) in [
        (secret("a secret of 17 bytes"), ours),
        // A version that was changed on the way ends the handshake.
        (own.clone(), theirs),
    ] {
        let (initiator, message) = Initiator::start(&own, &ours).expect("starts");
        if let Ok((answer, _)) = respond(&listener, &seen, &message) {
            assert!(initiator.finish(&answer).is_err());
        }
    }
    for bit in 0..8 * KEY_MESSAGE_BYTES {
        let (initiator, mut message) = Initiator::start(&own, &ours).expect("starts");
        let (mut answer, _) = respond(&own, &ours, &message).expect("answers");
        answer[bit / 8] ^= 1 << (bit % 8);
        let expected = Some(KeyError::NoSharedSecret);
        assert_eq!(initiator.finish(&answer).err(), expected, "bit {bit}");
        let (initiator, _) = Initiator::start(&own, &ours).expect("starts");
        message[bit / 8] ^= 1 << (bit % 8);
        if let Ok((answer, _)) = respond(&own, &ours, &message) {
            assert!(initiator.finish(&answer).is_err(), "bit {bit}");
        }
    }
}

/// A listener whose keys nobody else can compute has nothing to fear from a replayed first message.
#[test]
fn replayed_first_message_yields_new_keys() {
    let own = secret("a secret of 16 bytes");
    let (initiator, message) = Initiator::start(&own, &header()).expect("starts");
    let (answer, _) = respond(&own, &header(), &message).expect("answers");
    let (again, mut replayed) = respond(&own, &header(), &message).expect("answers");
    assert_ne!(answer, again);
    let mut dialler = initiator.finish(&answer).expect("the same secret");
    let mut recorded = seal(&mut dialler.keys, b"\xf0RECT");
    assert!(replayed.keys.opening.open(&mut recorded).is_err());
}

/// The values that an independent implementation (`tests/protocol/link_keys.py`) has computed.
#[derive(Deserialize)]
struct Vectors {
    secret: String,
    dialler_ephemeral: String,
    listener_ephemeral: String,
    pre_shared_key: String,
    key: String,
    key_answer: String,
    export_path: String,
    dialler: Vec<Sdu>,
    listener: Vec<Sdu>,
    low_order: LowOrder,
    tcp: Tcp,
}

/// A key agreement in which the dialler's public key is zero. It leads to keys, because only the secret proves anything.
#[derive(Deserialize)]
struct LowOrder {
    key: String,
    key_answer: String,
    /// The first SDU of the dialler.
    hello: String,
}

/// The key agreement of an `any` link that begins on TCP.
#[derive(Deserialize)]
struct Tcp {
    key: String,
    key_answer: String,
    any_key: String,
    any_tag: String,
}

/// An SDU before and after it is sealed.
#[derive(Deserialize)]
struct Sdu {
    content: String,
    sealed: String,
}

fn array(hex: &str) -> Derived {
    bytes(hex).try_into().expect("32 bytes")
}

fn vectors() -> Vectors {
    let text = include_str!("../../vectors/keys.json");
    serde_json::from_str(text).expect("valid")
}

/// Returns the message in KEY or KEY ANSWER.
fn message_of(sdu: &str) -> KeyMessage {
    match HandshakeMessage::decode(&bytes(sdu)) {
        Ok(HandshakeMessage::Key(key) | HandshakeMessage::KeyAnswer(key)) => key.message,
        other => panic!("{sdu}: {other:?}"),
    }
}

#[test]
fn key_of_low_order_is_answered() {
    let vectors = vectors();
    let (own, answering) = (secret(&vectors.secret), array(&vectors.listener_ephemeral));
    let key = message_of(&vectors.low_order.key);
    assert_eq!(key[..32], [0; 32]);
    let answered = respond_with(&own, &header(), &key, Some(&answering));
    let (answer, mut agreed) = answered.expect("answers");
    assert_eq!(answer, message_of(&vectors.low_order.key_answer));
    let mut hello = bytes(&vectors.low_order.hello);
    assert!(agreed.keys.opening.open(&mut hello).is_ok());
}

#[test]
fn key_agreement_on_tcp_has_another_header() {
    let vectors = vectors();
    let own = secret(&vectors.secret);
    let ephemerals = [&vectors.dialler_ephemeral, &vectors.listener_ephemeral];
    let [ephemeral, answering] = ephemerals.map(|hex| array(hex));
    let header = [&b"RECTM\x01"[..], &header()].concat();
    let started = Initiator::start_with(&own, &header, Some(&ephemeral));
    let (initiator, message) = started.expect("starts");
    assert_eq!(message, message_of(&vectors.tcp.key));
    let answered = respond_with(&own, &header, &message, Some(&answering));
    let (answer, _) = answered.expect("answers");
    assert_eq!(answer, message_of(&vectors.tcp.key_answer));
    let agreed = initiator.finish(&answer).expect("the same secret");
    for (label, key) in [
        ("any key", vectors.tcp.any_key),
        ("any tag", vectors.tcp.any_tag),
    ] {
        assert_eq!(agreed.exporter.key(label), array(&key));
    }
}

#[test]
fn agrees_with_an_independent_implementation() {
    let vectors = vectors();
    let own = secret(&vectors.secret);
    assert_eq!(own.pre_shared_key(), array(&vectors.pre_shared_key));
    let ephemerals = [&vectors.dialler_ephemeral, &vectors.listener_ephemeral];
    let [ephemeral, answering] = ephemerals.map(|hex| array(hex));
    let started = Initiator::start_with(&own, &header(), Some(&ephemeral));
    let (initiator, message) = started.expect("starts");
    let version = VERSION;
    let key = HandshakeMessage::Key(Key { version, message });
    assert_eq!(key.encode(), bytes(&vectors.key));
    let answered = respond_with(&own, &header(), &message, Some(&answering));
    let (message, mut listener) = answered.expect("answers");
    let answer = HandshakeMessage::KeyAnswer(Key { version, message });
    assert_eq!(answer.encode(), bytes(&vectors.key_answer));
    let mut dialler = initiator.finish(&message).expect("the same secret");
    assert_eq!(dialler.exporter.key("path"), array(&vectors.export_path));
    let keys = [&mut dialler.keys, &mut listener.keys];
    for (keys, sdus) in keys.into_iter().zip([vectors.dialler, vectors.listener]) {
        for sdu in sdus {
            let sealed = seal(keys, &bytes(&sdu.content));
            assert_eq!(sealed, bytes(&sdu.sealed), "{}", sdu.content);
        }
    }
}
