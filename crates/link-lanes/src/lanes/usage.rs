//! Counts the bytes that a link sends for each Zenoh key, with their share of everything that the link adds to them.
//!
//! Nothing is counted until somebody asks, and for a while after each question. Only the keys that are declared are kept all the
//! time ([`keys`]). Nothing in a batch makes the count fail: what cannot be parsed counts as [`Purpose::Other`].
mod batch;
pub mod keys;
#[cfg(test)]
mod tests;

use std::{
    collections::HashMap,
    time::{Duration, Instant},
};

use zenoh_protocol::core::WireExpr;

use self::{
    batch::{Batch, Part},
    keys::{KeyTable, Side},
};
use crate::lanes::{Lane, LANES};

/// The time before a question over which bytes are counted.
pub const WINDOW: Duration = Duration::from_secs(5);
/// The largest number of keys that are counted individually.
pub const MAX_KEYS: usize = 256;
/// The number of complete parts into which the window is divided.
const BUCKETS: usize = 10;
const BUCKET: Duration = Duration::from_millis(500);

/// The purpose of bytes that were sent.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Purpose {
    /// Messages with this key: values, requests and replies.
    Key(String),
    /// Zenoh's own messages: declarations, keep-alives, and the ends of replies.
    Zenoh,
    /// Messages of the link itself, such as acknowledgements.
    Link,
    /// Messages whose keys are not known or too many, and what cannot be parsed.
    Other,
}

/// The size of something that was sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Size {
    /// Number of bytes with everything that the link adds.
    pub bytes: u64,
    /// The part of the link's rate that it takes, in the bytes in which the link measures its rate.
    pub cost: u64,
}

impl std::ops::AddAssign for Size {
    fn add_assign(&mut self, other: Self) {
        self.bytes += other.bytes;
        self.cost += other.cost;
    }
}

/// The answer to a question.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UsageReport {
    /// The time over which bytes have been counted, at most a little more than [`WINDOW`]; zero in the answer that starts the count.
    pub window: Duration,
    /// The size of everything that was sent within this time for each purpose, in the order of the purposes.
    pub sent: Vec<(Purpose, Size)>,
}

/// Counts the bytes of a link.
#[derive(Debug, Default)]
pub struct Usage {
    count: Option<Box<Count>>,
}

/// A running count.
#[derive(Debug)]
struct Count {
    start: Instant,
    until: Instant,
    /// The number of the bucket that is being filled.
    bucket: u64,
    keys: HashMap<String, Buckets>,
    others: [Buckets; 3],
    /// The purpose of what was sent last on each lane, to which further fragments belong. An empty key stands for other bytes.
    last: [String; LANES],
    /// The key that is being put together, kept for its memory.
    key: String,
}

type Buckets = [Size; BUCKETS + 1];

impl Usage {
    /// Starts the count, or prolongs it until `keep` after `now`, and returns what was counted until now.
    pub fn ask(&mut self, now: Instant, keep: Duration) -> UsageReport {
        let count = self.count.get_or_insert_with(|| Box::new(Count::new(now)));
        count.until = count.until.max(now + keep);
        count.advance(now);
        count.report(now)
    }

    /// Counts a batch of Zenoh that was sent. `size` is that of the whole batch.
    pub fn on_batch(
        &mut self,
        keys: &KeyTable,
        lane: Lane,
        batch: &[u8],
        size: Size,
        now: Instant,
    ) {
        if let Some(count) = self.running(now) {
            count.on_batch(keys, lane, batch, size);
        }
    }

    /// Counts bytes that were sent in addition to the last batch of a lane.
    pub fn on_more(&mut self, lane: Lane, size: Size, now: Instant) {
        if let Some(count) = self.running(now) {
            count.add_to_last(lane, size);
        }
    }

    /// Counts a message of the link itself.
    pub fn on_own(&mut self, size: Size, now: Instant) {
        if let Some(count) = self.running(now) {
            count.add(&Purpose::Link, size);
        }
    }

    /// Returns the count, if it runs.
    fn running(&mut self, now: Instant) -> Option<&mut Count> {
        if now >= self.count.as_ref()?.until {
            self.count = None;
        }
        let count = self.count.as_mut()?;
        count.advance(now);
        Some(count)
    }
}

impl Count {
    fn new(now: Instant) -> Self {
        Self {
            start: now,
            until: now,
            bucket: 0,
            keys: HashMap::new(),
            others: Default::default(),
            last: Default::default(),
            key: String::new(),
        }
    }

    /// Begins new buckets, and forgets the keys of which nothing was sent within the window.
    fn advance(&mut self, now: Instant) {
        let bucket =
            (now.saturating_duration_since(self.start).as_millis() / BUCKET.as_millis()) as u64;
        if bucket == self.bucket {
            return;
        }
        let first = (self.bucket + 1).max(bucket.saturating_sub(BUCKETS as u64));
        for number in first..=bucket {
            let place = place_of(number);
            let all = self.keys.values_mut().chain(&mut self.others);
            all.for_each(|buckets| buckets[place] = Size::default());
        }
        self.bucket = bucket;
        let is_used = |buckets: &Buckets| buckets.iter().any(|size| size.bytes > 0);
        self.keys.retain(|_, buckets| is_used(buckets));
    }

    fn on_batch(&mut self, keys: &KeyTable, lane: Lane, batch: &[u8], size: Size) {
        // These are Zenoh's own messages, which the link may have compressed.
        if lane == Lane::first() {
            return self.add(&Purpose::Zenoh, size);
        }
        let (total, mut end) = (batch.len(), 0);
        let mut counted = Size::default();
        for part in Batch::new(batch) {
            // The share of this part, so that the shares of all parts add up.
            let mut share = |bytes: usize| {
                end += bytes;
                let until = Size {
                    bytes: size.bytes * end as u64 / total as u64,
                    cost: size.cost * end as u64 / total as u64,
                };
                let share = Size {
                    bytes: until.bytes - counted.bytes,
                    cost: until.cost - counted.cost,
                };
                counted = until;
                share
            };
            match part {
                Part::Keyed(expr, bytes) => {
                    let share = share(bytes);
                    self.add_key(keys, &expr, share);
                }
                Part::First(expr) => {
                    let share = share(total);
                    self.add_key(keys, &expr, share);
                }
                Part::Next => {
                    let share = share(total);
                    return self.add_to_last(lane, share);
                }
                Part::Zenoh(bytes) | Part::Declared(_, _, bytes) => {
                    let share = share(bytes);
                    self.add(&Purpose::Zenoh, share);
                }
                Part::Unknown(bytes) => {
                    let share = share(bytes);
                    self.key.clear();
                    self.add(&Purpose::Other, share);
                }
            }
        }
        self.last[lane.index()].clone_from(&self.key);
    }

    /// Counts bytes of a message with a key.
    fn add_key(&mut self, keys: &KeyTable, expr: &WireExpr<'_>, size: Size) {
        self.key.clear();
        if !keys.append(Side::Own, expr, &mut self.key) {
            self.key.clear();
        }
        let bucket = place_of(self.bucket);
        if let Some(buckets) = self.keys.get_mut(&self.key) {
            buckets[bucket] += size;
        } else if self.key.is_empty() || self.keys.len() >= MAX_KEYS {
            self.add(&Purpose::Other, size);
        } else {
            let mut buckets = Buckets::default();
            buckets[bucket] = size;
            self.keys.insert(self.key.clone(), buckets);
        }
    }

    /// Counts bytes for the message that was sent last on a lane.
    fn add_to_last(&mut self, lane: Lane, size: Size) {
        let bucket = place_of(self.bucket);
        match self.keys.get_mut(&self.last[lane.index()]) {
            Some(buckets) => buckets[bucket] += size,
            None if lane == Lane::first() => self.add(&Purpose::Zenoh, size),
            None => self.add(&Purpose::Other, size),
        }
    }

    fn add(&mut self, purpose: &Purpose, size: Size) {
        let [zenoh, link, other] = &mut self.others;
        let buckets = match purpose {
            Purpose::Zenoh => zenoh,
            Purpose::Link => link,
            Purpose::Key(_) | Purpose::Other => other,
        };
        buckets[place_of(self.bucket)] += size;
    }

    fn report(&self, now: Instant) -> UsageReport {
        let running = now.saturating_duration_since(self.start);
        let complete = BUCKET * self.bucket.min(BUCKETS as u64) as u32;
        let current = running.saturating_sub(BUCKET.saturating_mul(self.bucket as u32));
        let total = |buckets: &Buckets| {
            let mut total = Size::default();
            buckets.iter().for_each(|size| total += *size);
            total
        };
        let keys = self.keys.iter();
        let mut sent: Vec<_> = keys
            .map(|(key, buckets)| (Purpose::Key(key.clone()), total(buckets)))
            .collect();
        sent.sort_by(|(one, _), (other, _)| one.cmp(other));
        let purposes = [Purpose::Zenoh, Purpose::Link, Purpose::Other];
        sent.extend(purposes.into_iter().zip(self.others.iter().map(total)));
        sent.retain(|(_, size)| size.bytes > 0);
        UsageReport {
            window: complete + current,
            sent,
        }
    }
}

/// Returns the place of a bucket.
fn place_of(bucket: u64) -> usize {
    (bucket % (BUCKETS as u64 + 1)) as usize
}
