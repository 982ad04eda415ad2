//! Counts messages that did not arrive. Each publisher numbers its messages; a gap in the numbers means that messages
//! were lost in transit (over UDP) or while a link was down. Lost messages are not requested again.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use super::{
    attachment::{Attachment, Sent},
    expiry::Ages,
    sequence::{Order, Sequence},
};
use crate::{clock::MillisecondClock, name::Name};

/// The maximum number of publishers that are tracked. Beyond it, the ones that have been inactive for longest are
/// forgotten.
pub const MAX_SOURCES: usize = 1024;

/// The information that the attachment of a message provides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Arrival {
    /// The number of messages directly before this one that have not arrived.
    pub missed: u32,
    /// Whether a message that was sent later arrived before this one (possible over UDP). It had been counted as
    /// missed.
    pub late: bool,
    /// How much longer the message was on the way than the fastest one of its publisher; zero for a message that never expires.
    pub age: Duration,
}

/// How many messages of one sender were received and missed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct SenderCounts {
    /// The number of messages that arrived.
    pub received: u64,
    /// The number of messages that did not arrive, according to the sequence numbers.
    pub missed: u64,
}

#[derive(Debug)]
struct Source {
    sequence: Sequence,
    last_used: u64,
    ages: Ages,
}

#[derive(Debug, Default)]
struct Sender {
    counts: SenderCounts,
    sources: BTreeMap<u16, Source>,
}

/// Tracks the sequence numbers of all publishers.
#[derive(Debug)]
pub struct Gaps {
    own: MillisecondClock,
    senders: BTreeMap<Name, Sender>,
    /// Number of sources of all senders.
    sources: usize,
    clock: u64,
}

impl Gaps {
    /// Creates the state of a subscription that begins now.
    pub fn new(now: Instant) -> Self {
        Self {
            own: MillisecondClock::new(now, 0),
            senders: BTreeMap::new(),
            sources: 0,
            clock: 0,
        }
    }

    /// Handles a message of `robot` with that attachment. `now` is the time if the message expires, and `None` if it never does: only
    /// then its age matters. The messages of a publisher all expire, or none does.
    pub fn on_message(
        &mut self,
        robot: &Name,
        attachment: &Attachment,
        now: Option<Instant>,
    ) -> Arrival {
        self.clock += 1;
        let last_used = self.clock;
        if self.sources >= MAX_SOURCES && !self.knows(robot, attachment.source) {
            self.make_room();
        }
        let sender = sender_of(&mut self.senders, &mut self.sources, robot);
        let number = attachment.sequence;
        let source = sender.sources.entry(attachment.source).or_insert_with(|| {
            self.sources += 1;
            Source {
                // Messages that were sent before the subscription are not missed.
                sequence: Sequence::new(number.wrapping_sub(1)),
                last_used,
                ages: Ages::default(),
            }
        });
        source.last_used = last_used;
        let order = source.sequence.on_message(number);
        let missed = match order {
            Order::Next { missed } => missed,
            _ => 0,
        };
        let mut arrival = Arrival {
            missed,
            late: !matches!(order, Order::Next { .. }),
            age: Duration::ZERO,
        };
        if let (Sent::At(sent_ms), Some(now)) = (attachment.sent, now) {
            arrival.age = (source.ages).on_message(sent_ms, arrival.late, self.own, now);
        }
        let counts = &mut sender.counts;
        counts.received += 1;
        let found = match order {
            Order::Next { .. } => 0,
            Order::Repeated | Order::Late => 1,
            Order::Renumbered { miscounted } => {
                // The message with the wrong number may have had a wrong time, too.
                source.ages = Ages::default();
                u64::from(miscounted)
            }
        };
        counts.missed = counts.missed.saturating_sub(found) + u64::from(missed);
        arrival
    }

    /// Handles a message without a sequence number, from a program that does not use RECT.
    pub fn on_unnumbered(&mut self, robot: &Name) {
        let sender = sender_of(&mut self.senders, &mut self.sources, robot);
        sender.counts.received += 1;
    }

    /// Returns how many messages of each robot were received and missed.
    pub fn counts_by_sender(&self) -> impl Iterator<Item = (&Name, SenderCounts)> {
        let senders = self.senders.iter();
        senders.map(|(robot, sender)| (robot, sender.counts))
    }

    fn knows(&self, robot: &Name, source: u16) -> bool {
        let sender = self.senders.get(robot);
        sender.is_some_and(|sender| sender.sources.contains_key(&source))
    }

    /// Forgets the half of the sources that were inactive for longest.
    fn make_room(&mut self) {
        let sources = || {
            self.senders
                .values()
                .flat_map(|sender| sender.sources.values())
        };
        let mut last_used: Vec<u64> = sources().map(|source| source.last_used).collect();
        let (_, middle, _) = last_used.select_nth_unstable(MAX_SOURCES / 2);
        let middle = *middle;
        self.sources = 0;
        for sender in self.senders.values_mut() {
            sender.sources.retain(|_, source| source.last_used > middle);
            self.sources += sender.sources.len();
        }
    }
}

/// Returns what is known about a robot. Of too many ones, another one is forgotten.
fn sender_of<'a>(
    senders: &'a mut BTreeMap<Name, Sender>,
    sources: &mut usize,
    robot: &Name,
) -> &'a mut Sender {
    if senders.len() >= MAX_SOURCES && !senders.contains_key(robot) {
        let first = senders.pop_first();
        *sources -= first.map_or(0, |(_, sender)| sender.sources.len());
    }
    senders.entry(robot.clone()).or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> Name {
        Name::new(text).expect("valid name")
    }

    fn gaps() -> Gaps {
        Gaps::new(Instant::now())
    }

    fn on_message(gaps: &mut Gaps, robot: &Name, source: u16, sequence: u32) -> Arrival {
        let attachment = Attachment {
            source,
            sequence,
            sent: Sent::Unknown,
            lifetime_ms: None,
        };
        gaps.on_message(robot, &attachment, None)
    }

    #[test]
    fn counts_gaps_as_missed_and_late_messages_as_received() {
        let (mut gaps, a) = (gaps(), name("a"));
        let missed = |missed| Arrival {
            missed,
            ..Arrival::default()
        };
        assert_eq!(
            on_message(&mut gaps, &a, 1, 7),
            missed(0),
            "the first received message"
        );
        assert_eq!(on_message(&mut gaps, &a, 1, 8), missed(0));
        assert_eq!(on_message(&mut gaps, &a, 1, 11), missed(2));
        assert_eq!(
            on_message(&mut gaps, &a, 1, 10),
            Arrival {
                late: true,
                ..Arrival::default()
            }
        );
        assert_eq!(on_message(&mut gaps, &a, 1, 12), missed(0));
        assert_eq!(
            on_message(&mut gaps, &a, 2, 900),
            missed(0),
            "another publisher"
        );
        let counts_by_sender: Vec<_> = gaps.counts_by_sender().map(|(_, counts)| counts).collect();
        assert_eq!(
            counts_by_sender,
            [SenderCounts {
                received: 6,
                missed: 1
            }]
        );
    }

    #[test]
    fn sequence_numbers_wrap_around() {
        let (mut gaps, a) = (gaps(), name("a"));
        on_message(&mut gaps, &a, 1, u32::MAX - 1);
        assert_eq!(on_message(&mut gaps, &a, 1, 1).missed, 2);
    }

    #[test]
    fn one_number_far_ahead_is_neither_missed_nor_makes_later_messages_late() {
        let (mut gaps, a) = (gaps(), name("a"));
        on_message(&mut gaps, &a, 1, 0);
        on_message(&mut gaps, &a, 1, 1 << 30);
        let late = (1..100).filter(|&n| on_message(&mut gaps, &a, 1, n).late);
        assert_eq!(late.count(), 8);
        let (_, counts) = gaps.counts_by_sender().next().expect("one sender");
        assert_eq!((counts.received, counts.missed), (101, 0));
    }

    #[test]
    fn memory_is_bounded_with_invented_publishers() {
        let mut gaps = gaps();
        for n in 0..100_000u32 {
            let robot = name(&format!("r{}", n / 60_000));
            on_message(&mut gaps, &robot, n as u16, n);
            on_message(&mut gaps, &name(&format!("x{n}")), 0, 0);
            assert!(gaps.sources <= MAX_SOURCES && gaps.senders.len() <= MAX_SOURCES);
        }
        let sources = gaps.senders.values().map(|sender| sender.sources.len());
        assert_eq!(sources.sum::<usize>(), gaps.sources);
    }
}
