//! Counts messages that did not arrive. Each publisher numbers its messages; a gap in the numbers means that messages
//! were lost in transit (over UDP) or while a link was down. Lost messages are not requested again.
use std::collections::{BTreeMap, HashMap};

use super::name::Name;

/// The maximum number of publishers that are tracked. Beyond it, the ones that have been inactive for longest are
/// forgotten.
pub const MAX_SOURCES: usize = 1024;

/// The information that the sequence number of a message provides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gap {
    /// The number of messages directly before this one that have not arrived.
    pub missed: u32,
    /// Whether a message that was sent later arrived before this one (possible over UDP). It had been counted as
    /// missed.
    pub late: bool,
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
    last: u32,
    last_used: u64,
}

/// Tracks the sequence numbers of all publishers.
#[derive(Debug, Default)]
pub struct Gaps {
    sources: HashMap<(Name, u16), Source>,
    counts_by_sender: BTreeMap<Name, SenderCounts>,
    clock: u64,
}

impl Gaps {
    /// Handles the message with number `sequence` of publisher `source` on `robot`.
    pub fn on_message(&mut self, robot: &Name, source: u16, sequence: u32) -> Gap {
        self.clock += 1;
        let last_used = self.clock;
        let gap = match self.sources.get_mut(&(robot.clone(), source)) {
            None => {
                // Messages that were sent before the subscription are not missed.
                self.make_room();
                let last = sequence;
                let key = (robot.clone(), source);
                self.sources.insert(key, Source { last, last_used });
                Gap::default()
            }
            Some(source) => {
                source.last_used = last_used;
                let ahead = sequence.wrapping_sub(source.last);
                if ahead == 0 || ahead > u32::MAX / 2 {
                    Gap {
                        missed: 0,
                        late: true,
                    }
                } else {
                    source.last = sequence;
                    Gap {
                        missed: ahead - 1,
                        late: false,
                    }
                }
            }
        };
        let counts = self.counts_of(robot);
        counts.received += 1;
        if gap.late {
            counts.missed = counts.missed.saturating_sub(1);
        }
        counts.missed += u64::from(gap.missed);
        gap
    }

    /// Handles a message without a sequence number, from a program that does not use RECT.
    pub fn on_unnumbered(&mut self, robot: &Name) {
        self.counts_of(robot).received += 1;
    }

    /// Returns how many messages of each robot were received and missed.
    pub fn counts_by_sender(&self) -> impl Iterator<Item = (&Name, SenderCounts)> {
        self.counts_by_sender
            .iter()
            .map(|(robot, counts)| (robot, *counts))
    }

    fn counts_of(&mut self, robot: &Name) -> &mut SenderCounts {
        if self.counts_by_sender.len() >= MAX_SOURCES && !self.counts_by_sender.contains_key(robot)
        {
            self.counts_by_sender.pop_first();
        }
        self.counts_by_sender.entry(robot.clone()).or_default()
    }

    fn make_room(&mut self) {
        if self.sources.len() < MAX_SOURCES {
            return;
        }
        let mut last_used: Vec<u64> = self
            .sources
            .values()
            .map(|source| source.last_used)
            .collect();
        let (_, middle, _) = last_used.select_nth_unstable(MAX_SOURCES / 2);
        let middle = *middle;
        self.sources.retain(|_, source| source.last_used > middle);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> Name {
        Name::new(text).expect("valid name")
    }

    #[test]
    fn counts_gaps_as_missed_and_late_messages_as_received() {
        let (mut gaps, a) = (Gaps::default(), name("a"));
        let missed = |missed| Gap {
            missed,
            late: false,
        };
        assert_eq!(
            gaps.on_message(&a, 1, 7),
            missed(0),
            "the first received message"
        );
        assert_eq!(gaps.on_message(&a, 1, 8), missed(0));
        assert_eq!(gaps.on_message(&a, 1, 11), missed(2));
        assert_eq!(
            gaps.on_message(&a, 1, 10),
            Gap {
                missed: 0,
                late: true
            }
        );
        assert_eq!(gaps.on_message(&a, 1, 12), missed(0));
        assert_eq!(gaps.on_message(&a, 2, 900), missed(0), "another publisher");
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
        let (mut gaps, a) = (Gaps::default(), name("a"));
        gaps.on_message(&a, 1, u32::MAX - 1);
        assert_eq!(gaps.on_message(&a, 1, 1).missed, 2);
    }

    #[test]
    fn memory_is_bounded_with_invented_publishers() {
        let mut gaps = Gaps::default();
        for n in 0..100_000u32 {
            let robot = name(&format!("r{}", n / 60_000));
            gaps.on_message(&robot, n as u16, n);
            gaps.on_message(&name(&format!("x{n}")), 0, 0);
        }
        assert!(gaps.sources.len() <= MAX_SOURCES && gaps.counts_by_sender.len() <= MAX_SOURCES);
    }
}
