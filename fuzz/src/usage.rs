//! Counts any batches that Zenoh sends or receives: nothing makes the count fail, and everything that was sent is counted once.
use std::time::{Duration, Instant};

use link_lanes::{
    lanes::Lane,
    usage::{
        keys::{KeyTable, Side},
        Size, Usage, MAX_KEYS,
    },
};

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let (mut keys, mut usage, now) = (KeyTable::default(), Usage::default(), Instant::now());
    let keep = Duration::from_secs(5);
    usage.ask(now, keep);
    let (mut rest, mut bytes) = (input, 0);
    while let [first, size, others @ ..] = rest {
        let (batch, others) = others.split_at(usize::from(*size).min(others.len()));
        rest = others;
        match first % 8 {
            0 => keys.on_batch(Side::Own, batch),
            1 => keys.on_batch(Side::Peer, batch),
            number => {
                let Some(lane) = Lane::new(number) else { continue };
                let size = Size {
                    bytes: batch.len() as u64 + 9,
                    cost: batch.len() as u64 + 24,
                };
                usage.on_batch(&keys, lane, batch, size, now);
                // An empty batch is not sent.
                bytes += if batch.is_empty() { 0 } else { size.bytes };
            }
        }
    }
    let report = usage.ask(now, keep);
    assert!(report.sent.len() <= MAX_KEYS + 3);
    assert_eq!(report.sent.iter().map(|(_, size)| size.bytes).sum::<u64>(), bytes);
}
