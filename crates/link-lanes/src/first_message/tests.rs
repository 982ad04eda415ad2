//! Tests the decisions of a listener: `cargo test -p link-lanes --lib first_message`. `vectors/handshake.json` contains the
//! cases, which an independent implementation (`tests/protocol/link_messages.py`) has written from `PROTOCOL.md`.
use std::convert::Infallible;

use serde::Deserialize;

use super::*;
use crate::{
    hello::{NodeId, VERSION},
    key_agreement::{respond, Initiator},
    vectors::bytes,
};

#[derive(Deserialize)]
struct Vectors {
    secret: String,
    first: Vec<First>,
    sealed: Vec<Sealed>,
    hellos: Vec<Decoded>,
    /// Hellos, and whether their senders accept compressed batches.
    compressed: Vec<(String, bool)>,
    order: Vec<[String; 2]>,
}

/// The answers to a first SDU: the REFUSE, or what begins a link.
#[derive(Deserialize)]
struct First {
    case: String,
    sdu: String,
    without_secret: String,
    with_secret: String,
}

/// The answer to a sealed message after KEY ANSWER, by its content before it is sealed.
#[derive(Deserialize)]
struct Sealed {
    case: String,
    content: String,
    answer: String,
    answer_is_sealed: bool,
}

#[derive(Deserialize)]
struct Decoded {
    sdu: String,
    node: u64,
    mtu: u16,
    window: u16,
    name: String,
    intervals: Option<Vec<u16>>,
    link: Option<u64>,
    joins: bool,
}

fn vectors() -> Vectors {
    let text = include_str!("../../vectors/handshake.json");
    serde_json::from_str(text).expect("valid")
}

fn answer_to(rejection: &Rejection) -> String {
    match rejection.refusal() {
        Some(refusal) => hex(&HandshakeMessage::Refuse(refusal).encode()),
        None => "none".to_owned(),
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn answer_to_first(sdu: &[u8], secret: Option<&Secret>) -> String {
    match decide(sdu, secret) {
        Ok(FirstMessage::Hello(_)) => "accept".to_owned(),
        Ok(FirstMessage::Plain) => "plain".to_owned(),
        Ok(FirstMessage::Key(key, secret)) => {
            match respond(secret, &Key::header(key.version), &key.message) {
                Ok(_) => "key answer".to_owned(),
                Err(error) => answer_to(&error.into()),
            }
        }
        Err(rejection) => answer_to(&rejection),
    }
}

#[test]
fn first_sdus_get_the_documented_answers() {
    let vectors = vectors();
    let secret = Secret::new(vectors.secret.as_bytes()).expect("long enough");
    for First {
        case,
        sdu,
        without_secret,
        with_secret,
    } in vectors.first
    {
        let sdu = bytes(&sdu);
        assert_eq!(answer_to_first(&sdu, None), without_secret, "{case}");
        assert_eq!(answer_to_first(&sdu, Some(&secret)), with_secret, "{case}");
    }
}

#[test]
fn sealed_messages_get_the_documented_answers() {
    let vectors = vectors();
    let secret = Secret::new(vectors.secret.as_bytes()).expect("long enough");
    let header = Key::header(VERSION);
    for Sealed {
        case,
        content,
        answer,
        answer_is_sealed,
    } in vectors.sealed
    {
        let (initiator, message) = Initiator::start(&secret, &header).expect("starts");
        let (message, mut listener) = respond(&secret, &header, &message).expect("answers");
        let mut dialler = initiator.finish(&message).expect("the same secret");
        let mut sdu = bytes(&content);
        let Ok(_) = (dialler.keys.sealing).seal(&mut sdu, |_| Ok::<_, Infallible>(true));
        let decided = decide_sealed(&mut listener.keys, &mut sdu);
        let is_sealed = decided.as_ref().err().is_none_or(Rejection::is_sealed);
        let decided = decided.map_or_else(|error| answer_to(&error), |_| "accept".to_owned());
        assert_eq!((decided, is_sealed), (answer, answer_is_sealed), "{case}");
        // Without the keys, nothing but the dialler's own refusal has another answer.
        let mut sdu = bytes(&content);
        let decided = decide_sealed(&mut listener.keys, &mut sdu);
        assert!(
            matches!(decided, Err(Rejection::NotAuthentic(_))),
            "{case}, not sealed"
        );
    }
}

#[test]
fn refusal_of_a_dialler_with_another_secret_is_not_answered() {
    let secret = Secret::new(b"a secret of 16 bytes").expect("long enough");
    let header = Key::header(VERSION);
    let (_, message) = Initiator::start(&secret, &header).expect("starts");
    let (_, mut agreed) = respond(&secret, &header, &message).expect("answers");
    let mut sdu = HandshakeMessage::Refuse(Refusal::Secret).encode();
    let rejected = decide_sealed(&mut agreed.keys, &mut sdu).expect_err("refused");
    assert_eq!(rejected, Rejection::RefusedByDialler);
    assert_eq!(rejected.refusal(), None);
}

#[test]
fn hellos_decode_to_the_documented_fields() {
    for Decoded {
        sdu,
        node,
        mtu,
        window,
        name,
        intervals,
        link,
        joins,
    } in vectors().hellos
    {
        let message = HandshakeMessage::decode(&bytes(&sdu));
        let Ok(HandshakeMessage::Hello(hello) | HandshakeMessage::Accept(hello)) = message else {
            panic!("{sdu}: {message:?}");
        };
        assert_eq!(hello.node, NodeId(node), "{sdu}");
        assert_eq!((hello.mtu, hello.window, hello.name), (mtu, window, name));
        let decoded = hello.intervals.map(|intervals| {
            let requested = intervals.requested.unwrap_or(0);
            [&[requested][..], &intervals.avoid].concat()
        });
        assert_eq!(decoded, intervals, "{sdu}");
        let path = hello.path.map(|path| (path.link, path.joins));
        assert_eq!(path, link.map(|link| (link, joins)), "{sdu}");
    }
}

#[test]
fn hellos_state_whether_compressed_batches_are_accepted() {
    for (sdu, accepts) in vectors().compressed {
        let message = HandshakeMessage::decode(&bytes(&sdu));
        let Ok(HandshakeMessage::Hello(hello) | HandshakeMessage::Accept(hello)) = message else {
            panic!("{sdu}: {message:?}");
        };
        assert_eq!(hello.accepts_compressed, accepts, "{sdu}");
    }
}

#[test]
fn node_ids_are_little_endian_integers() {
    for pair in vectors().order {
        let [low, high] = pair.map(|sdu| match HandshakeMessage::decode(&bytes(&sdu)) {
            Ok(HandshakeMessage::Hello(hello)) => hello.node,
            other => panic!("{sdu}: {other:?}"),
        });
        assert!(low < high, "{low:?} {high:?}");
    }
}
