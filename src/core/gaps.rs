//! Owns the counting of what did not arrive: each publisher numbers its messages, and a number that is left out is a message
//! that was lost on the way (over UDP), or while a link was down. Nothing is asked for again.
use std::collections::{BTreeMap, HashMap};

use super::name::Name;

/// The most publishers that are followed at a time; of more, those not heard for longest are forgotten.
pub const MAX_SOURCES: usize = 1024;

/// What a message's number says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gap {
    /// So many before this one have not arrived.
    pub missed: u32,
    /// It arrives after one that was sent later (UDP may do that), and had been counted as missed.
    pub late: bool,
}

/// What arrived of one robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Tally {
    /// Messages that arrived.
    pub received: u64,
    /// Messages that did not, by their numbers.
    pub missed: u64,
}

#[derive(Debug)]
struct Source {
    last: u32,
    heard: u64,
}

/// Follows the numbers of all publishers.
#[derive(Debug, Default)]
pub struct Gaps {
    sources: HashMap<(Name, u16), Source>,
    tallies: BTreeMap<Name, Tally>,
    clock: u64,
}

impl Gaps {
    /// A message has come that is number `sequence` of `source` at `robot`.
    pub fn on_message(&mut self, robot: &Name, source: u16, sequence: u32) -> Gap {
        self.clock += 1;
        let heard = self.clock;
        let gap = match self.sources.get_mut(&(robot.clone(), source)) {
            None => {
                // What was sent before one listened is not missed.
                self.make_room();
                let last = sequence;
                let key = (robot.clone(), source);
                self.sources.insert(key, Source { last, heard });
                Gap::default()
            }
            Some(known) => {
                known.heard = heard;
                let ahead = sequence.wrapping_sub(known.last);
                if ahead == 0 || ahead > u32::MAX / 2 {
                    Gap {
                        missed: 0,
                        late: true,
                    }
                } else {
                    known.last = sequence;
                    Gap {
                        missed: ahead - 1,
                        late: false,
                    }
                }
            }
        };
        let tally = self.tally(robot);
        tally.received += 1;
        if gap.late {
            tally.missed = tally.missed.saturating_sub(1);
        }
        tally.missed += u64::from(gap.missed);
        gap
    }

    /// A message without a number has come, of a stock program.
    pub fn on_unnumbered(&mut self, robot: &Name) {
        self.tally(robot).received += 1;
    }

    /// What arrived of each robot.
    pub fn tallies(&self) -> impl Iterator<Item = (&Name, Tally)> {
        self.tallies.iter().map(|(robot, tally)| (robot, *tally))
    }

    fn tally(&mut self, robot: &Name) -> &mut Tally {
        if self.tallies.len() >= MAX_SOURCES && !self.tallies.contains_key(robot) {
            self.tallies.pop_first();
        }
        self.tallies.entry(robot.clone()).or_default()
    }

    fn make_room(&mut self) {
        if self.sources.len() < MAX_SOURCES {
            return;
        }
        let mut heard: Vec<u64> = self.sources.values().map(|source| source.heard).collect();
        let (_, middle, _) = heard.select_nth_unstable(MAX_SOURCES / 2);
        let middle = *middle;
        self.sources.retain(|_, source| source.heard > middle);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> Name {
        Name::new(text).expect("a name")
    }

    #[test]
    fn what_is_left_out_is_missed_and_what_comes_late_is_not() {
        let (mut gaps, a) = (Gaps::default(), name("a"));
        let missed = |missed| Gap {
            missed,
            late: false,
        };
        assert_eq!(
            gaps.on_message(&a, 1, 7),
            missed(0),
            "the first that is heard"
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
        assert_eq!(gaps.on_message(&a, 2, 900), missed(0), "another program");
        let tallies: Vec<_> = gaps.tallies().map(|(_, tally)| tally).collect();
        assert_eq!(
            tallies,
            [Tally {
                received: 6,
                missed: 1
            }]
        );
    }

    #[test]
    fn after_the_highest_number_comes_0() {
        let (mut gaps, a) = (Gaps::default(), name("a"));
        gaps.on_message(&a, 1, u32::MAX - 1);
        assert_eq!(gaps.on_message(&a, 1, 1).missed, 2);
    }

    #[test]
    fn who_makes_up_publishers_takes_no_more_memory() {
        let mut gaps = Gaps::default();
        for n in 0..100_000u32 {
            let robot = name(&format!("r{}", n / 60_000));
            gaps.on_message(&robot, n as u16, n);
            gaps.on_message(&name(&format!("x{n}")), 0, 0);
        }
        assert!(gaps.sources.len() <= MAX_SOURCES && gaps.tallies.len() <= MAX_SOURCES);
    }
}
