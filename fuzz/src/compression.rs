//! Restores what a peer sends in place of compressed batches: the result is bounded, however much the bytes stand for. Batches that this
//! side compresses are restored, also if some of them are not sent.
use std::time::Instant;

use link_lanes::compression::{Compressor, Decompressor};

/// Largest batch, in bytes.
const MAX: usize = 1000;

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let (mut rogue, mut out, mut into) = (Decompressor::default(), Compressor::default(), Decompressor::default());
    let now = Instant::now();
    let mut rest = input;
    while let Some((&size, bytes)) = rest.split_first() {
        let (part, others) = bytes.split_at(usize::from(size).min(bytes.len()));
        rest = others;
        for first in [0x3f, 0x1f] {
            let sent = [&[first][..], part].concat();
            if let Ok(batch) = rogue.decompress(sent, MAX) {
                assert!((1..=MAX).contains(&batch.len()));
            }
        }
        // Zenoh's batches do not begin as compressed ones.
        let batch = [&[0x25][..], part].concat();
        let sent = out.compress(&batch, now).into_owned();
        assert!(sent.len() <= batch.len());
        if size % 7 != 0 {
            out.on_sent();
            assert_eq!(into.decompress(sent, MAX), Ok(batch));
        }
    }
}
