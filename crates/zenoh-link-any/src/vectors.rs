//! Tests the protocol with the vectors that an independent implementation (`tests/protocol/any_link.py`) has written from
//! `PROTOCOL.md`: `cargo test -p zenoh-link-any --lib vectors`
use std::net::IpAddr;

use serde::Deserialize;

use crate::{
    connection::seal,
    frame::{self, nearest, Frame},
    in_lane::InLane,
    multipath::Options,
    offer,
    proof::{Proof, Role},
};

#[derive(Deserialize)]
struct Vectors {
    any_key: String,
    any_tag: String,
    dialler_ephemeral: String,
    listener_ephemeral: String,
    connections: Vec<TcpPath>,
    frames: Vec<FrameCase>,
    positions: Vec<Position>,
    streams: Vec<Stream>,
    offers: Vec<Offer>,
}

/// The bytes on a TCP connection that becomes a path, and the first two frames of each side.
#[derive(Deserialize)]
struct TcpPath {
    dialler: String,
    opening: String,
    answer: String,
    dialler_frames: [String; 2],
    listener_frames: [String; 2],
}

#[derive(Deserialize)]
struct FrameCase {
    case: String,
    frame: String,
    is_valid: bool,
}

/// The position with these lower bits, if `next` is the next one.
#[derive(Deserialize)]
struct Position {
    lower: u32,
    next: u64,
    position: Option<u64>,
}

/// Data frames of one lane, and its batches, or none if the frames end the link.
#[derive(Deserialize)]
struct Stream {
    case: String,
    frames: Vec<String>,
    batches: Option<Vec<String>>,
}

/// The addresses in an offer, or none if it is malformed.
#[derive(Deserialize)]
struct Offer {
    case: String,
    body: String,
    addresses: Option<Vec<IpAddr>>,
}

fn vectors() -> Vectors {
    let text = include_str!("../vectors/version-1.json");
    serde_json::from_str(text).expect("valid")
}

fn bytes(hex: &str) -> Vec<u8> {
    let digit = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).expect("hexadecimal");
    (0..hex.len()).step_by(2).map(digit).collect()
}

fn array<const N: usize>(hex: &str) -> [u8; N] {
    bytes(hex).try_into().expect("of that size")
}

#[test]
fn connections_are_proven_and_sealed_as_documented() {
    let vectors = vectors();
    let (key, tag) = (array(&vectors.any_key), array(&vectors.any_tag));
    let proof = |role| Proof::new(key, tag, role);
    let (opener, acceptor) = (proof(Role::Opener), proof(Role::Acceptor));
    let dialling: [u8; 32] = array(&vectors.dialler_ephemeral);
    let answering: [u8; 32] = array(&vectors.listener_ephemeral);
    for path in vectors.connections {
        let (dialler, listener) = match path.dialler.as_str() {
            "opener" => (&opener, &acceptor),
            _ => (&acceptor, &opener),
        };
        let opened = dialler.open_with(Some(&dialling));
        let (opening, message) = opened.expect("opens");
        assert_eq!(message, bytes(&path.opening));
        let answered = listener.answer_with(&array(&path.opening), Some(&answering));
        let (answer, listener) = answered.expect("proven");
        assert_eq!(answer, array(&path.answer));
        let dialler = opening.finish(&answer).expect("proven");
        let sides = [
            (&dialler, path.dialler_frames, [&[][..], &[0x13]]),
            (
                &listener,
                path.listener_frames,
                [&[0x12, 1, 0, 0, 0][..], &[0x13]],
            ),
        ];
        for (keys, expected, frames) in sides {
            for (number, (frame, expected)) in (0..).zip(frames.into_iter().zip(expected)) {
                let mut sealed = Vec::new();
                seal(keys, number, frame, &mut sealed).expect("seals");
                assert_eq!(sealed, bytes(&expected), "{}, {number}", path.dialler);
            }
        }
    }
}

#[test]
fn frames_are_decoded_as_documented() {
    for FrameCase {
        case,
        frame,
        is_valid,
    } in vectors().frames
    {
        let frame = bytes(&frame);
        let decoded = frame::decode(&frame);
        assert_eq!(decoded.is_ok(), is_valid, "{case}: {decoded:?}");
        if let Ok(decoded) = decoded {
            let mut encoded = Vec::new();
            decoded.encode(&mut encoded);
            assert_eq!(encoded, frame, "{case}");
        }
    }
}

#[test]
fn positions_are_restored_as_documented() {
    for Position {
        lower,
        next,
        position,
    } in vectors().positions
    {
        assert_eq!(nearest(lower, next), position, "{lower} after {next}");
    }
}

#[test]
fn streams_are_cut_into_batches_as_documented() {
    let max_batch = Options::default().max_batch;
    for Stream {
        case,
        frames,
        batches,
    } in vectors().streams
    {
        let mut lane = InLane::default();
        let received = frames.iter().try_for_each(|hex| {
            let frame = bytes(hex);
            let Ok(Frame::Data { offset, bytes, .. }) = frame::decode(&frame) else {
                panic!("{case}: {hex} is not a data frame");
            };
            lane.on_bytes(offset, bytes, max_batch).map(drop)
        });
        assert_eq!(received.is_ok(), batches.is_some(), "{case}: {received:?}");
        if let Some(batches) = batches {
            let expected: Vec<_> = batches.iter().map(|batch| bytes(batch)).collect();
            let taken: Vec<_> = std::iter::from_fn(|| lane.take()).collect();
            assert_eq!(taken, expected, "{case}");
        }
    }
}

#[test]
fn offers_are_decoded_as_documented() {
    for Offer {
        case,
        body,
        addresses,
    } in vectors().offers
    {
        let decoded = offer::decode(&bytes(&body)).ok();
        let decoded: Option<Vec<_>> = decoded.map(|all| all.iter().map(|one| one.ip()).collect());
        assert_eq!(decoded, addresses, "{case}");
    }
}
