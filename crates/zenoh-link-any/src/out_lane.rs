//! The sending side of a lane: a stream of batches, kept until the peer has acknowledged them.
use std::{
    collections::VecDeque,
    ops::Range,
    time::{Duration, Instant},
};

use link_lanes::lanes::{
    backlog::{Backlog, Limits, Queued},
    batch_kind::BatchKind,
    report::MeanTime,
};

use crate::{batch_length, in_lane::MAX_EARLY_BYTES, ranges::Ranges};

/// The sending side of a lane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LaneReport {
    /// Bytes that no path has carried yet.
    pub waiting_bytes: u64,
    /// Moving average of the time from the queueing of a batch to its acknowledgement; `None` until it was measured.
    pub delay: Option<Duration>,
    /// Number of batches that were withdrawn because Zenoh abandoned their message.
    pub abandoned_batches: u64,
}

/// A batch whose bytes are not all acknowledged.
#[derive(Debug)]
struct Batch {
    /// The position of its length in the stream.
    start: u64,
    /// Its length and its bytes.
    bytes: Vec<u8>,
    kind: BatchKind,
    /// Whether the batch counts towards the lane's backlog.
    counts: bool,
    /// Whether every live path carries it.
    is_copied: bool,
    /// When it was queued.
    since: Instant,
}

impl Batch {
    fn end(&self) -> u64 {
        self.start + self.bytes.len() as u64
    }

    /// Returns the approximate memory that the batch occupies.
    fn memory(&self) -> usize {
        self.bytes.len() + size_of::<Self>()
    }
}

impl Queued for Batch {
    fn kind(&self) -> BatchKind {
        self.kind
    }

    fn cost(&self) -> usize {
        self.bytes.len()
    }

    fn counts(&mut self) -> &mut bool {
        &mut self.counts
    }
}

/// The sending side of a lane.
#[derive(Debug, Default)]
pub(crate) struct OutLane {
    batches: VecDeque<Batch>,
    memory: usize,
    backlog: Backlog,
    /// The position after the last batch.
    end: u64,
    /// The position of the first byte that no path has carried yet.
    next: u64,
    /// The bytes that the peer has acknowledged, of the batches that are kept.
    acked: Ranges,
    /// The bytes that have to be sent again.
    lost: Ranges,
    /// Whether the peer has stopped the lane.
    pub(crate) is_stopped: bool,
    /// How long it took until the batches were acknowledged.
    delay: MeanTime,
    /// The number of batches that were withdrawn.
    abandoned: u64,
    is_used: bool,
}

impl OutLane {
    /// Returns whether the lane accepts a batch of that kind, given what waits before it.
    pub(crate) fn accepts(&self, kind: BatchKind, limits: Limits, now: Instant) -> bool {
        self.backlog.accepts(kind, self.unsent_bytes(), limits, now)
    }

    /// Returns when the lane accepts a batch of that kind even without room.
    pub(crate) fn overdue_at(&self, kind: BatchKind) -> Option<Instant> {
        self.backlog.overdue_at(kind)
    }

    /// Appends a batch.
    pub(crate) fn push(&mut self, batch: &[u8], kind: BatchKind, is_copied: bool, now: Instant) {
        let mut bytes = Vec::with_capacity(batch.len() + 2);
        batch_length::encode(batch.len(), &mut bytes);
        bytes.extend_from_slice(batch);
        let batch = Batch {
            start: self.end,
            kind,
            counts: false,
            is_copied,
            since: now,
            bytes,
        };
        self.is_used = true;
        self.end = batch.end();
        self.memory += batch.memory();
        self.backlog.queue(&mut self.batches, batch, now);
    }

    /// Withdraws the fragments of the last message that no path has carried yet.
    pub(crate) fn abandon_message(&mut self) {
        let (end, memory, next) = (&mut self.end, &mut self.memory, self.next);
        let abandoned = &mut self.abandoned;
        self.backlog.abandon(
            &mut self.batches,
            |batch| batch.start >= next,
            |batch| {
                *end = batch.start;
                *memory -= batch.memory();
                *abandoned += 1;
            },
        );
    }

    /// Returns the approximate memory that the lane occupies, in bytes.
    pub(crate) fn memory(&self) -> usize {
        self.memory
    }

    /// Returns the number of bytes that no path has carried yet.
    pub(crate) fn unsent_bytes(&self) -> usize {
        (self.end - self.next) as usize
    }

    /// Returns the state of the lane; `None` if it was never used.
    pub(crate) fn report(&self) -> Option<LaneReport> {
        self.is_used.then(|| LaneReport {
            waiting_bytes: self.unsent_bytes() as u64,
            delay: self.delay.get(),
            abandoned_batches: self.abandoned,
        })
    }

    /// Returns whether all was acknowledged.
    pub(crate) fn is_empty(&self) -> bool {
        self.batches.is_empty()
    }

    /// Returns the next bytes to send again, at most `max`.
    pub(crate) fn next_lost(&self, max: usize) -> Option<Range<u64>> {
        let first = self.lost.first()?;
        Some(first.start..first.end.min(first.start + max as u64))
    }

    /// Returns the next bytes that no path has carried, at most `max`. With `only_copied`, only of batches that every live path
    /// carries.
    pub(crate) fn next_new(&self, max: usize, only_copied: bool) -> Option<Range<u64>> {
        if self.next == self.end || self.is_stopped {
            return None;
        }
        // The receiver accepts no bytes that are farther beyond those that are missing.
        let farthest = self.start() + MAX_EARLY_BYTES;
        let mut end = self.end.min(self.next + max as u64).min(farthest);
        if only_copied {
            let mut copied_end = self.next;
            for batch in self.batches.range(self.index_at(self.next)..) {
                if !batch.is_copied {
                    break;
                }
                copied_end = batch.end();
            }
            end = end.min(copied_end);
        }
        (end > self.next).then_some(self.next..end)
    }

    /// Records that a path carries these bytes.
    pub(crate) fn on_sent(&mut self, range: &Range<u64>) {
        self.lost.remove(range);
        self.next = self.next.max(range.end);
    }

    /// Records that a path may have lost these bytes. Those that were acknowledged meanwhile are not sent again.
    pub(crate) fn on_lost(&mut self, range: Range<u64>) {
        for missing in self
            .acked
            .missing_from(range.start.max(self.start())..range.end)
        {
            self.lost.insert(missing);
        }
    }

    /// Records that the peer has these bytes, and forgets the batches that it has completely.
    pub(crate) fn on_acked(&mut self, range: &Range<u64>, now: Instant) {
        self.lost.remove(range);
        self.acked.insert(range.start.max(self.start())..range.end);
        while let Some(first) = self.batches.front() {
            if !self.acked.contains(&(first.start..first.end())) {
                break;
            }
            self.memory -= first.memory();
            self.delay.add(now.saturating_duration_since(first.since));
            if first.counts {
                self.backlog.on_sent(first.bytes.len(), now);
            }
            self.batches.pop_front();
        }
        let start = self.start();
        self.acked.remove(&(0..start));
    }

    /// Returns whether the peer has all these bytes.
    pub(crate) fn is_acked(&self, range: &Range<u64>) -> bool {
        self.acked
            .contains(&(range.start.max(self.start())..range.end.max(self.start())))
    }

    /// Returns the parts of the range, by batches, that every live path carries.
    pub(crate) fn copied_in(&self, range: &Range<u64>) -> Vec<Range<u64>> {
        let first = self.index_at(range.start);
        let batches = self.batches.range(first..);
        batches
            .take_while(|batch| batch.start < range.end)
            .filter(|batch| batch.is_copied)
            .map(|batch| batch.start.max(range.start)..batch.end().min(range.end))
            .collect()
    }

    /// Appends these bytes of the stream, which must be kept.
    pub(crate) fn append_to(&self, range: &Range<u64>, to: &mut Vec<u8>) {
        let mut at = range.start;
        for batch in self.batches.range(self.index_at(range.start)..) {
            if at >= range.end {
                break;
            }
            let begin = (at - batch.start) as usize;
            let end = (range.end.min(batch.end()) - batch.start) as usize;
            to.extend_from_slice(&batch.bytes[begin..end]);
            at = batch.end();
        }
    }

    /// Returns the batches that begin within these bytes: each with the number of its bytes among them, including its length.
    pub(crate) fn starting_in<'a>(
        &'a self,
        range: &'a Range<u64>,
    ) -> impl Iterator<Item = (&'a [u8], u64)> {
        let is_before = |batch: &Batch| batch.start < range.start;
        let batches = (self.batches).range(self.batches.partition_point(is_before)..);
        let within = batches.take_while(|batch| batch.start < range.end);
        within.map(|batch| {
            let content = batch_length::decode(&batch.bytes).map_or(0, |(_, size)| size);
            let bytes = batch.end().min(range.end) - batch.start;
            (&batch.bytes[content..], bytes)
        })
    }

    /// Returns the position of the first byte that is kept.
    fn start(&self) -> u64 {
        self.batches.front().map_or(self.end, |batch| batch.start)
    }

    /// Returns the index of the batch that contains the position.
    fn index_at(&self, position: u64) -> usize {
        self.batches
            .partition_point(|batch| batch.end() <= position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_that_the_peer_does_not_accept_yet_are_not_sent() {
        let (mut lane, now) = (OutLane::default(), Instant::now());
        let kind = BatchKind::Whole {
            is_droppable: false,
        };
        for _ in 0..100 {
            lane.push(&[7; 20_000], kind, false, now);
        }
        let mut sent = Vec::new();
        while let Some(range) = lane.next_new(16_000, false) {
            lane.on_sent(&range);
            sent.push(range);
        }
        assert_eq!(lane.next, MAX_EARLY_BYTES);
        // A path that is slower than others has not delivered the first bytes.
        lane.on_acked(&(sent[1].start..lane.next), now);
        assert_eq!(lane.next_new(16_000, false), None);
        lane.on_acked(&sent[0], now);
        let next = MAX_EARLY_BYTES..MAX_EARLY_BYTES + 16_000;
        assert_eq!(lane.next_new(16_000, false), Some(next));
    }
}
