//! The receiving side of a lane: puts the bytes that arrive on several paths in order, and cuts them into batches.
use std::collections::{BTreeMap, VecDeque};

use crate::{batch_length, frame::nearest};

/// Number of bytes beyond the next one that may arrive early, because a path was lost or is slower than another: more than
/// a sender may have unacknowledged.
pub const MAX_EARLY_BYTES: u64 = 1 << 20;
/// Number of bytes of unread batches at which a lane is stopped, and at which it may continue.
const HIGH_WATERMARK: usize = 262_144;
const LOW_WATERMARK: usize = HIGH_WATERMARK / 2;
/// Memory of a batch in addition to its bytes.
const BATCH_OVERHEAD_BYTES: usize = 24;
/// Number of bytes that may arrive on a stopped lane: the bytes that were unacknowledged when it was stopped, and as much again for the
/// time until the peer knows it.
const MAX_HELD_BYTES: usize = HIGH_WATERMARK + (1 << 20);

/// A violation of the protocol by the peer, on a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LaneError {
    /// The batch is empty, or larger than agreed.
    #[error("a batch of {size} bytes, where 1 to {max} were agreed")]
    BatchSize {
        /// Its size, in bytes.
        size: usize,
        /// The largest batch, in bytes.
        max: usize,
    },
    /// The bytes are far beyond those that have arrived.
    #[error("bytes from position {0}, far beyond those that have arrived")]
    TooEarly(u64),
    /// The bytes are from before the beginning of the stream.
    #[error("bytes from before the beginning of the lane")]
    BeforeStart,
    /// Two paths have brought different bytes for the same position.
    #[error("two paths have brought different bytes for position {0}")]
    Contradiction(u64),
    /// More arrived on a stopped lane than could have been on the way.
    #[error("it keeps sending on a lane that was stopped")]
    Stopped,
}

/// The receiving side of a lane.
#[derive(Debug, Default)]
pub(crate) struct InLane {
    /// The position of the next byte of the stream.
    next: u64,
    /// Bytes that have arrived beyond `next`, by their position.
    early: BTreeMap<u64, Vec<u8>>,
    early_bytes: usize,
    /// The beginning of a batch whose end has not arrived yet, with its length.
    partial: Vec<u8>,
    batches: VecDeque<Vec<u8>>,
    held_bytes: usize,
    is_stopped: bool,
    /// Number of bytes that had arrived before on another path.
    repeated_bytes: u64,
}

impl InLane {
    /// Handles bytes that have arrived. Returns whether a batch was completed.
    pub(crate) fn on_bytes(
        &mut self,
        offset: u32,
        mut bytes: &[u8],
        max_batch: usize,
    ) -> Result<bool, LaneError> {
        let mut at = nearest(offset, self.next).ok_or(LaneError::BeforeStart)?;
        let end = at + bytes.len() as u64;
        if end > self.next + MAX_EARLY_BYTES {
            return Err(LaneError::TooEarly(at));
        }
        if at < self.next {
            let known = ((self.next - at) as usize).min(bytes.len());
            self.repeated_bytes += known as u64;
            bytes = bytes.get(known..).unwrap_or_default();
            at = self.next;
        }
        if bytes.is_empty() {
            return Ok(false);
        }
        if self.held_bytes + self.early_bytes + bytes.len() > MAX_HELD_BYTES {
            return Err(LaneError::Stopped);
        }
        if at > self.next {
            self.insert_early(at, bytes)?;
            return Ok(false);
        }
        let before = self.batches.len();
        self.append(bytes, max_batch)?;
        while let Some(entry) = self.early.first_entry() {
            if *entry.key() > self.next {
                break;
            }
            let (start, early) = entry.remove_entry();
            self.early_bytes -= early.len();
            let known = ((self.next - start) as usize).min(early.len());
            self.repeated_bytes += known as u64;
            self.append(early.get(known..).unwrap_or_default(), max_batch)?;
        }
        Ok(self.batches.len() > before)
    }

    /// Keeps bytes beyond the next one, without those that are kept already.
    fn insert_early(&mut self, mut at: u64, mut bytes: &[u8]) -> Result<(), LaneError> {
        while !bytes.is_empty() {
            // Bytes that are kept from before this position, or at it.
            if let Some((&start, kept)) = self.early.range(..=at).next_back() {
                let skip = (at - start) as usize;
                if skip < kept.len() {
                    let both = (kept.len() - skip).min(bytes.len());
                    if kept[skip..skip + both] != bytes[..both] {
                        return Err(LaneError::Contradiction(at));
                    }
                    self.repeated_bytes += both as u64;
                    at += both as u64;
                    bytes = &bytes[both..];
                    continue;
                }
            }
            let following = self.early.range(at..).next();
            let room = following.map_or(bytes.len() as u64, |(&start, _)| start - at);
            let new = (room as usize).min(bytes.len());
            self.early.insert(at, bytes[..new].to_vec());
            self.early_bytes += new;
            at += new as u64;
            bytes = &bytes[new..];
        }
        Ok(())
    }

    /// Appends the next bytes of the stream, and cuts off the batches that are complete.
    fn append(&mut self, bytes: &[u8], max_batch: usize) -> Result<(), LaneError> {
        self.next += bytes.len() as u64;
        let mut rest = bytes;
        if !self.partial.is_empty() {
            // Completes the length first, and then the batch.
            while !rest.is_empty() {
                let missing = match batch_length::decode(&self.partial) {
                    None => 1,
                    Some((length, head)) => {
                        check_size(length, max_batch)?;
                        head + length - self.partial.len()
                    }
                };
                let taken = missing.min(rest.len());
                self.partial.extend_from_slice(&rest[..taken]);
                rest = &rest[taken..];
                if let Some((length, head)) = batch_length::decode(&self.partial) {
                    check_size(length, max_batch)?;
                    if self.partial.len() == head + length {
                        let batch = self.partial.split_off(head);
                        self.partial.clear();
                        self.hold(batch);
                        break;
                    }
                }
            }
        }
        while let Some((length, head)) = batch_length::decode(rest) {
            check_size(length, max_batch)?;
            let Some(batch) = rest.get(head..head + length) else {
                break;
            };
            self.hold(batch.to_vec());
            rest = &rest[head + length..];
        }
        self.partial.extend_from_slice(rest);
        Ok(())
    }

    fn hold(&mut self, batch: Vec<u8>) {
        self.held_bytes += batch.len() + BATCH_OVERHEAD_BYTES;
        self.batches.push_back(batch);
    }

    /// Takes the next batch.
    pub(crate) fn take(&mut self) -> Option<Vec<u8>> {
        let batch = self.batches.pop_front()?;
        self.held_bytes -= batch.len() + BATCH_OVERHEAD_BYTES;
        Some(batch)
    }

    /// Stops the lane or lets it continue, according to what is held. Returns whether that is a change.
    pub(crate) fn update_stopped(&mut self) -> bool {
        let limit = if self.is_stopped {
            LOW_WATERMARK
        } else {
            HIGH_WATERMARK
        };
        let is_stopped = self.held_bytes > limit;
        std::mem::replace(&mut self.is_stopped, is_stopped) != is_stopped
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    /// Returns the number of bytes that had arrived before on another path.
    pub(crate) fn repeated_bytes(&self) -> u64 {
        self.repeated_bytes
    }
}

fn check_size(size: usize, max: usize) -> Result<(), LaneError> {
    match size {
        0 => Err(LaneError::BatchSize { size, max }),
        _ if size > max => Err(LaneError::BatchSize { size, max }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::truncated;

    const MAX_BATCH: usize = 300;

    /// Returns a stream of batches of 1 to 300 bytes, and the batches.
    fn stream(batches: usize) -> (Vec<u8>, Vec<Vec<u8>>) {
        let (mut stream, mut all) = (Vec::new(), Vec::new());
        for n in 0..batches {
            let batch: Vec<u8> = (0..1 + n * 7 % MAX_BATCH)
                .map(|at| (n + at) as u8)
                .collect();
            batch_length::encode(batch.len(), &mut stream);
            stream.extend_from_slice(&batch);
            all.push(batch);
        }
        (stream, all)
    }

    fn taken(lane: &mut InLane) -> Vec<Vec<u8>> {
        std::iter::from_fn(|| lane.take()).collect()
    }

    #[test]
    fn pieces_of_any_size_give_the_batches() {
        let (stream, batches) = stream(100);
        for piece in 1..500 {
            let mut lane = InLane::default();
            for (n, bytes) in stream.chunks(piece).enumerate() {
                let offset = truncated((n * piece) as u64);
                lane.on_bytes(offset, bytes, MAX_BATCH).expect("valid");
            }
            assert_eq!(taken(&mut lane), batches, "pieces of {piece} bytes");
        }
    }

    #[test]
    fn order_and_repetition_of_pieces_do_not_matter() {
        use rand_pcg::{
            rand_core::{RngCore, SeedableRng},
            Pcg32,
        };
        let (stream, batches) = stream(60);
        for seed in 0..200 {
            let mut rng = Pcg32::seed_from_u64(seed);
            let mut below = |limit: usize| rng.next_u32() as usize % limit;
            let mut lane = InLane::default();
            let mut pieces = Vec::new();
            // Overlapping pieces that cover everything, each one twice.
            for start in (0..stream.len()).step_by(50) {
                for _ in 0..2 {
                    let begin = start.saturating_sub(below(120));
                    pieces.push(begin..(start + 50 + below(120)).min(stream.len()));
                }
            }
            while !pieces.is_empty() {
                let piece = pieces.swap_remove(below(pieces.len()));
                let offset = truncated(piece.start as u64);
                lane.on_bytes(offset, &stream[piece], MAX_BATCH)
                    .expect("valid");
            }
            assert_eq!(taken(&mut lane), batches, "seed {seed}");
            assert!(lane.early.is_empty() && lane.early_bytes == 0);
            assert!(lane.repeated_bytes() > 0);
        }
    }

    #[test]
    fn violations_are_detected() {
        let mut lane = InLane::default();
        let far = truncated(MAX_EARLY_BYTES);
        assert_eq!(
            lane.on_bytes(far, b"x", MAX_BATCH),
            Err(LaneError::TooEarly(MAX_EARLY_BYTES))
        );
        let before = truncated(0_u64.wrapping_sub(3));
        assert_eq!(
            lane.on_bytes(before, b"three and more", MAX_BATCH),
            Err(LaneError::BeforeStart)
        );
        lane.on_bytes(10, b"early", MAX_BATCH).expect("valid");
        assert_eq!(
            lane.on_bytes(8, b"xxearlY", MAX_BATCH),
            Err(LaneError::Contradiction(10))
        );
        let (size, max) = (0, MAX_BATCH);
        assert_eq!(
            InLane::default().on_bytes(0, &[0], max),
            Err(LaneError::BatchSize { size, max })
        );
        let (size, mut large) = (MAX_BATCH + 1, Vec::new());
        batch_length::encode(size, &mut large);
        assert_eq!(
            InLane::default().on_bytes(0, &large, max),
            Err(LaneError::BatchSize { size, max })
        );
    }

    #[test]
    fn lane_that_is_not_read_is_stopped_and_its_memory_is_bounded() {
        let mut lane = InLane::default();
        let mut batch = Vec::new();
        batch_length::encode(MAX_BATCH, &mut batch);
        batch.resize(batch.len() + MAX_BATCH, 1);
        let mut at = 0;
        while !lane.update_stopped() {
            lane.on_bytes(truncated(at), &batch, MAX_BATCH)
                .expect("valid");
            at += batch.len() as u64;
        }
        assert!(lane.is_stopped());
        let refused = loop {
            match lane.on_bytes(truncated(at), &batch, MAX_BATCH) {
                Ok(_) => at += batch.len() as u64,
                Err(error) => break error,
            }
        };
        assert_eq!(refused, LaneError::Stopped);
        assert!(at < 2 * MAX_HELD_BYTES as u64);
        while lane.held_bytes > LOW_WATERMARK {
            assert!(!lane.update_stopped());
            lane.take().expect("held");
        }
        assert!(lane.update_stopped() && !lane.is_stopped());
    }
}
