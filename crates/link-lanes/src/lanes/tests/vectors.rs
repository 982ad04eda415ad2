//! Tests an open link with the vectors of the protocol: `vectors/open-link.json`, which an independent implementation
//! (`tests/protocol/link_messages.py`) has written from `PROTOCOL.md`.
use std::{convert::Infallible, time::Instant};

use serde::Deserialize;

use super::{lane, sent, BOUNDS};
use crate::{
    lanes::{
        sdu::{Content, Protection, Sealer},
        Lanes,
    },
    vectors::bytes,
};

#[derive(Deserialize)]
struct Vectors {
    checks: Vec<Check>,
    mtu: usize,
    window: u16,
    received: Vec<Received>,
    acknowledgements: Vec<Acknowledgements>,
}

#[derive(Deserialize)]
struct Check {
    number: u32,
    content: String,
    sdu: String,
}

/// SDUs that arrive, and the reason of the goodbye if the last one ends the link.
#[derive(Deserialize)]
struct Received {
    case: String,
    sdus: Vec<String>,
    goodbye: Option<u8>,
}

/// The sizes of batches that are not taken, and the SDUs that are sent after each.
#[derive(Deserialize)]
struct Acknowledgements {
    window: u16,
    batches: Vec<usize>,
    sdus: Vec<Vec<String>>,
}

fn vectors() -> Vectors {
    let text = include_str!("../../../vectors/open-link.json");
    serde_json::from_str(text).expect("valid")
}

fn sealed(sealer: &mut Sealer, content: Vec<u8>) -> Vec<u8> {
    let mut sdu = content;
    let Ok(_) = sealer.seal(&mut sdu, |_| Ok::<_, Infallible>(true));
    sdu
}

#[test]
fn checks_are_those_of_the_vectors() {
    for Check {
        number,
        content,
        sdu,
    } in vectors().checks
    {
        let mut sealer = Sealer::Check { number };
        assert_eq!(
            sealed(&mut sealer, bytes(&content)),
            bytes(&sdu),
            "{number}"
        );
    }
}

#[test]
fn received_sdus_end_the_link_with_the_documented_reason() {
    let vectors = vectors();
    for Received {
        case,
        sdus,
        goodbye,
    } in vectors.received
    {
        let (mtu, window, now) = (vectors.mtu, vectors.window, Instant::now());
        let mut lanes = Lanes::new(BOUNDS, mtu, window, window, Protection::checks());
        let mut violations = Vec::new();
        for (at, sdu) in sdus.iter().enumerate() {
            if let Err(violation) = lanes.on_sdu(&mut bytes(sdu), now) {
                violations.push((at, violation.goodbye().code()));
            }
        }
        let expected = goodbye.map(|reason| (sdus.len() - 1, reason));
        assert_eq!(violations, Vec::from_iter(expected), "{case}");
    }
}

#[test]
fn batches_are_acknowledged_as_documented() {
    for Acknowledgements {
        window,
        batches,
        sdus,
    } in vectors().acknowledgements
    {
        let (mtu, now) = (1000, Instant::now());
        let mut lanes = Lanes::new(BOUNDS, mtu, window, window, Protection::checks());
        let mut peer = Protection::checks().out;
        for (size, expected) in batches.into_iter().zip(sdus) {
            let batch = Content::Batch(lane(5), &vec![7; size]).encode();
            let mut sdu = sealed(&mut peer, batch);
            lanes.on_sdu(&mut sdu, now).expect("follows the protocol");
            let answers: Vec<_> = std::iter::from_fn(|| sent(&mut lanes, now)).collect();
            let expected: Vec<_> = expected.iter().map(|sdu| bytes(sdu)).collect();
            assert_eq!(answers, expected, "window {window}, batch of {size}");
        }
    }
}
