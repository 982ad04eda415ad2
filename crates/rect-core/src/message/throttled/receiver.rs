//! Takes from the streams of a robot what one of its subscribers wants.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use super::{header::Header, Wish};
use crate::{
    message::attachment::Attachment,
    name::{topic::Topic, Name},
};

/// The maximum number of streams that are remembered.
const MAX_STREAMS: usize = 1024;
/// How long a subscriber may receive faster than it asked for after it has received nothing: a link delivers together what was sent apart.
const LAG: Duration = Duration::from_secs(1);

/// The streams that a subscriber receives.
#[derive(Debug)]
pub struct Receiver {
    wish: Wish,
    streams: BTreeMap<(Name, Topic), Stream>,
    /// The number of streams that have begun, modulo 2^16.
    begun: u16,
}

/// One topic of one robot.
#[derive(Debug)]
pub struct Stream {
    wish: Wish,
    /// Identifies the stream among those of its robot.
    source: u16,
    /// The number of the last message.
    number: u32,
    /// The time from which the next message is delivered.
    due: Instant,
    /// Whether a value has differed from the one before it since the last message that was delivered.
    is_changed: bool,
    /// Whether the last message was delivered, or left out for good.
    is_settled: bool,
    /// The publisher and the sequence number of the last message that was delivered.
    delivered: Option<(u16, u32)>,
    /// The number of messages that did not arrive since.
    missed: u32,
}

/// The place of a message in its stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Identifies the stream among those of its robot.
    pub source: u16,
    /// The number of the message there.
    pub number: u32,
}

/// The gap before a message that the subscriber receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The number of messages that did not arrive since the last one that it received.
    pub missed: u32,
    /// The number of messages that its publisher has sent since, and that were left out.
    pub skipped: u32,
}

impl Receiver {
    /// Creates the receiver of a subscription.
    pub fn new(wish: Wish) -> Self {
        Self {
            wish,
            streams: BTreeMap::new(),
            begun: 0,
        }
    }

    /// Returns the stream of a message that arrives now.
    pub fn stream(
        &mut self,
        sender: &Name,
        topic: &Topic,
        header: Header,
        now: Instant,
    ) -> &mut Stream {
        let key = (sender.clone(), topic.clone());
        if header.is_first {
            self.streams.remove(&key);
        }
        if self.streams.len() >= MAX_STREAMS && !self.streams.contains_key(&key) {
            self.streams.pop_first();
        }
        let (wish, begun) = (self.wish, &mut self.begun);
        self.streams.entry(key).or_insert_with(|| {
            *begun = begun.wrapping_add(1);
            Stream::new(wish, *begun, header, now)
        })
    }
}

impl Stream {
    fn new(wish: Wish, source: u16, first: Header, now: Instant) -> Self {
        Self {
            wish,
            source,
            number: first.number.into(),
            due: now,
            is_changed: true,
            is_settled: false,
            delivered: None,
            missed: 0,
        }
    }

    /// Returns the place of a message.
    pub fn place(&mut self, header: Header) -> Place {
        let after = header.after(self.number);
        let number = self.number.wrapping_add_signed(after);
        if after > 0 {
            self.number = number;
        }
        Place {
            source: self.source,
            number,
        }
    }

    /// Decides whether the subscriber receives a message. `missed` messages of the stream are missing before it.
    pub fn on_message(
        &mut self,
        header: Header,
        attachment: Option<Attachment>,
        missed: u32,
        now: Instant,
    ) -> Option<Gap> {
        self.missed = self.missed.saturating_add(missed);
        if header.repeats && self.is_settled && missed == 0 {
            return None;
        }
        self.is_settled = true;
        // A message that is missing may have had another value.
        self.is_changed |= !header.is_unchanged || missed > 0;
        if self.wish.is_on_change() && !self.is_changed {
            return None;
        }
        let interval = self.wish.interval();
        // The intervals of a stream vary.
        if now + interval / 8 < self.due {
            self.is_settled = false;
            return None;
        }
        let earliest = now.checked_sub(LAG).unwrap_or(now);
        self.due = (self.due + interval).max(earliest);
        self.is_changed = false;
        let missed = std::mem::take(&mut self.missed);
        let number = attachment.map(|sent| (sent.source, sent.sequence));
        let last = std::mem::replace(&mut self.delivered, number);
        let skipped = match (last, number) {
            (Some((before, last)), Some((source, number))) if before == source => {
                let between = number.wrapping_sub(last).wrapping_sub(1);
                // A number before the last one is of a message that was overtaken.
                let between = (between <= u32::MAX / 2).then_some(between);
                between.unwrap_or(0).saturating_sub(missed)
            }
            _ => 0,
        };
        Some(Gap { missed, skipped })
    }
}
