//! Tests the messages of the handshake: `cargo test -p link-lanes --lib hello`
use super::*;
use crate::key_agreement::KEY_MESSAGE_BYTES;

fn hello(name: &str) -> Hello {
    Hello {
        version: VERSION,
        node: NodeId(0x0123_4567_89ab_cdef),
        mtu: 1000,
        window: 12_000,
        name: name.to_owned(),
        intervals: None,
        path: None,
        accepts_compressed: false,
    }
}

fn hello_with_intervals(requested: Option<u16>, avoid: &[u16]) -> Hello {
    let intervals = IntervalUnits {
        requested,
        avoid: avoid.to_vec(),
    };
    Hello {
        intervals: Some(intervals),
        path: None,
        ..hello("ab")
    }
}

/// Returns a hello with all optional fields.
fn longest_hello() -> Hello {
    Hello {
        name: "x".repeat(MAX_NAME),
        path: Some(PathOf {
            link: u64::MAX,
            joins: true,
        }),
        accepts_compressed: true,
        ..hello_with_intervals(Some(24), &[25; MAX_INTERVALS - 1])
    }
}

fn key() -> Key {
    Key {
        version: VERSION,
        message: [7; KEY_MESSAGE_BYTES],
    }
}

#[test]
fn every_message_decodes_to_what_was_encoded() {
    let longest = "x".repeat(MAX_NAME);
    for message in [
        HandshakeMessage::Hello(hello("wombat-1")),
        HandshakeMessage::Hello(hello("")),
        HandshakeMessage::Accept(hello(&longest)),
        HandshakeMessage::Refuse(Refusal::Crossing),
        HandshakeMessage::Refuse(Refusal::Secret),
        HandshakeMessage::Refuse(Refusal::Other(200)),
        HandshakeMessage::Hello(hello_with_intervals(Some(24), &[25, 3200])),
        HandshakeMessage::Accept(hello_with_intervals(None, &[])),
        HandshakeMessage::Hello(longest_hello()),
        HandshakeMessage::Key(key()),
        HandshakeMessage::KeyAnswer(key()),
    ] {
        assert_eq!(HandshakeMessage::decode(&message.encode()), Ok(message));
    }
}

#[test]
fn layout_is_as_documented() {
    let sdu = HandshakeMessage::Hello(hello("ab")).encode();
    assert_eq!(
        sdu,
        b"RECT\x01\x02\xef\xcd\xab\x89\x67\x45\x23\x01\xe8\x03\xe0\x2e\x02ab"
    );
    let with_intervals = HandshakeMessage::Hello(hello_with_intervals(Some(24), &[25, 300]));
    let expected = [&sdu[..], b"I\x03\x18\x00\x19\x00\x2c\x01"].concat();
    assert_eq!(with_intervals.encode(), expected);
    let sdu = HandshakeMessage::Key(key()).encode();
    assert_eq!(sdu, [&b"RECT\x04\x02"[..], &[7; 48]].concat());
    assert_eq!(sdu[..6], Key::header(VERSION));
    let answer = HandshakeMessage::KeyAnswer(key()).encode();
    assert_eq!(answer, [&b"RECT\x05\x02"[..], &[7; 48]].concat());
}

#[test]
fn truncated_message_is_rejected_at_every_length() {
    for message in [
        HandshakeMessage::Hello(hello("wombat-1")),
        HandshakeMessage::Key(key()),
        HandshakeMessage::KeyAnswer(key()),
    ] {
        let sdu = message.encode();
        for length in 0..sdu.len() {
            assert!(
                HandshakeMessage::decode(&sdu[..length]).is_err(),
                "{length} bytes"
            );
        }
    }
}

#[test]
fn fields_of_a_later_version_are_ignored() {
    let mut sdu = HandshakeMessage::Hello(hello("wombat-1")).encode();
    sdu.extend_from_slice(&[9; 20]);
    assert_eq!(
        HandshakeMessage::decode(&sdu),
        Ok(HandshakeMessage::Hello(hello("wombat-1")))
    );
    sdu.resize(MAX_SIZE + 1, 9);
    assert_eq!(
        HandshakeMessage::decode(&sdu),
        Err(HandshakeMessageError::Length(MAX_SIZE + 1))
    );
}

#[test]
fn invalid_fields_are_reported() {
    let good = HandshakeMessage::Hello(hello("ab")).encode();
    let with = |at: usize, byte: u8| {
        let mut sdu = good.clone();
        sdu[at] = byte;
        HandshakeMessage::decode(&sdu)
    };
    assert_eq!(with(0, b'X'), Err(HandshakeMessageError::NotAHello));
    assert_eq!(with(4, 9), Err(HandshakeMessageError::Kind(9)));
    assert_eq!(with(5, 0), Err(HandshakeMessageError::Version(0)));
    assert_eq!(with(5, 1), Err(HandshakeMessageError::Version(1)));
    let mut small = good.clone();
    small[14..16].copy_from_slice(&127u16.to_le_bytes());
    assert_eq!(
        HandshakeMessage::decode(&small),
        Err(HandshakeMessageError::Mtu(127))
    );
    let mut small = good.clone();
    small[16..18].copy_from_slice(&511u16.to_le_bytes());
    assert_eq!(
        HandshakeMessage::decode(&small),
        Err(HandshakeMessageError::Window(511))
    );
    assert_eq!(with(18, 30), Err(HandshakeMessageError::Name));
    assert_eq!(with(19, 0xff), Err(HandshakeMessageError::Name));
}

#[test]
fn zenoh_init_never_begins_like_a_hello() {
    for flags in 0..8u8 {
        assert_ne!(flags << 5 | 0x01, MAGIC[0]);
    }
}

#[test]
fn invalid_intervals_are_ignored() {
    let valid = HandshakeMessage::Hello(hello("ab"));
    let sdu = valid.encode();
    for intervals in [
        &b"I"[..],
        b"I\x00",
        b"I\x02\x18\x00",
        b"I\x01\x05\x00",
        b"I\x02\x18\x00\x00\x00",
        b"I\x19",
        b"J\x01\x18\x00",
    ] {
        let received = HandshakeMessage::decode(&[&sdu[..], intervals].concat());
        assert_eq!(received, Ok(valid.clone()), "{intervals:?}");
    }
}

#[test]
fn longest_hello_fits() {
    let hello = Hello {
        intervals: hello_with_intervals(Some(24), &[25; MAX_INTERVALS]).intervals,
        ..longest_hello()
    };
    let sdu = HandshakeMessage::Hello(hello).encode();
    assert!(sdu.len() <= MAX_SIZE, "{}", sdu.len());
    let HandshakeMessage::Hello(hello) = HandshakeMessage::decode(&sdu).expect("valid") else {
        panic!("a hello");
    };
    let avoid = hello.intervals.expect("present").avoid;
    assert_eq!(avoid.len(), MAX_INTERVALS - 1);
}
