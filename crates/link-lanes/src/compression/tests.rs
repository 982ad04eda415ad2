//! Tests the compression of batches: `cargo test -p link-lanes --lib compression`. `vectors/compression.json` contains the parts that another
//! implementation of DEFLATE has written, from section 4.1 of `PROTOCOL.md`.
use rand_pcg::{rand_core::RngCore, Pcg32};
use serde::Deserialize;

use super::*;
use crate::vectors::bytes;

const MTU: usize = 1000;

fn random(size: usize, seed: u64) -> Vec<u8> {
    let mut bytes = vec![0; size];
    Pcg32::new(seed, 1).fill_bytes(&mut bytes);
    // Zenoh sends no batch that looks compressed.
    bytes[0] = 0x25;
    bytes
}

/// Returns batches of declarations, as a router sends them for 600 services.
fn declarations() -> Vec<Vec<u8>> {
    let keys = (0..600).map(|n| format!("rect/wombat-{}/gripper/service-{}", 3 + n / 40, n % 40));
    let keys: Vec<_> = keys.collect();
    let batches = keys.chunks(20).map(|keys| {
        let keys = keys.iter().enumerate();
        let declared =
            keys.flat_map(|(n, key)| [&[0x9e, 0x31, 0x08, n as u8], key.as_bytes()].concat());
        [0x25, 0x01].into_iter().chain(declared).collect()
    });
    batches.collect()
}

#[test]
fn every_batch_is_restored() {
    let (mut out, mut into, now) = (
        Compressor::default(),
        Decompressor::default(),
        Instant::now(),
    );
    for seed in 0..300 {
        let batches = [
            random(1 + seed as usize % MTU, seed),
            vec![0x25; 1 + (7 * seed as usize) % MTU],
            vec![4],
            random(MTU, seed),
        ];
        for batch in batches {
            let sent = out.compress(&batch, now);
            assert!(sent.len() <= batch.len());
            out.on_sent();
            assert_eq!(into.decompress(sent.into_owned(), MTU), Ok(batch));
        }
    }
}

#[test]
fn declarations_take_less_than_a_quarter() {
    let (mut out, mut into, now) = (
        Compressor::default(),
        Decompressor::default(),
        Instant::now(),
    );
    let (mut before, mut after) = (0, 0);
    for batch in declarations() {
        let sent = out.compress(&batch, now);
        out.on_sent();
        (before, after) = (before + batch.len(), after + sent.len());
        assert_eq!(into.decompress(sent.into_owned(), MTU), Ok(batch));
    }
    assert!(before > 20_000 && after * 4 < before, "{before}, {after}");
}

#[test]
fn batch_that_was_not_sent_is_not_part_of_the_stream() {
    let (mut out, mut into, now) = (
        Compressor::default(),
        Decompressor::default(),
        Instant::now(),
    );
    for (n, batch) in declarations().into_iter().enumerate() {
        let sent = out.compress(&batch, now).into_owned();
        // Zenoh has given up the call, before or after the batch was queued.
        let (is_known, is_received) = (n % 3 != 1, n % 5 != 1 || n % 3 != 1);
        if is_known {
            out.on_sent();
        }
        if is_received {
            assert_eq!(into.decompress(sent, MTU), Ok(batch), "{n}");
        }
    }
}

#[test]
fn stream_ends_at_a_keep_alive_after_a_pause() {
    let (mut out, now) = (Compressor::default(), Instant::now());
    let batches = declarations();
    let mut first_byte = |batch: &[u8], at: Instant| {
        let first = out.compress(batch, at)[0];
        out.on_sent();
        first
    };
    assert_eq!(first_byte(&batches[0], now), BEGINS);
    assert_eq!(first_byte(&[4], now + IDLE / 2), 4);
    assert_eq!(first_byte(&batches[1], now + IDLE / 2), CONTINUES);
    assert_eq!(first_byte(&[4], now + IDLE), 4);
    assert_eq!(first_byte(&batches[2], now + IDLE), CONTINUES);
    assert_eq!(first_byte(&[4], now + 2 * IDLE), 4);
    assert_eq!(first_byte(&batches[3], now + 2 * IDLE), BEGINS);
}

#[test]
fn batch_over_the_limit_is_rejected_however_small_it_was_sent() {
    let batch = vec![0x25; 16_000];
    let sent = Compressor::default()
        .compress(&batch, Instant::now())
        .into_owned();
    assert!(sent.len() < 100);
    let restored = |max| Decompressor::default().decompress(sent.clone(), max);
    assert_eq!(restored(16_000), Ok(batch));
    for max in [1, 128, 15_999] {
        assert_eq!(restored(max), Err(NotCompressed { max }));
    }
}

#[derive(Deserialize)]
struct Case {
    case: String,
    /// The bytes that the peer sends, and their batch; `null` if they end the link.
    parts: Vec<(String, Option<String>)>,
}

#[derive(Deserialize)]
struct Vectors {
    mtu: usize,
    streams: Vec<Case>,
}

#[test]
fn streams_of_another_implementation_are_restored() {
    let text = include_str!("../../vectors/compression.json");
    let vectors: Vectors = serde_json::from_str(text).expect("valid");
    for Case { case, parts } in vectors.streams {
        let mut into = Decompressor::default();
        for (n, (part, batch)) in parts.into_iter().enumerate() {
            let restored = into.decompress(bytes(&part), vectors.mtu).ok();
            assert_eq!(restored, batch.as_deref().map(bytes), "{case}, part {n}");
        }
    }
}
