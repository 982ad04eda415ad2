//! Defines connection intervals, and when two of them may be used by links of one radio.
use std::{fmt, time::Duration};

/// A connection interval: the time between two connection events, in units of 1.25 ms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionInterval(u16);

/// Number of candidates on either side of the preferred interval.
pub const SPREAD: u16 = 8;
/// Two intervals conflict unless each is at least this many times their greatest common divisor.
const MIN_RATIO: u16 = 3;

impl ConnectionInterval {
    /// The shortest interval: 7.5 ms (Core Specification, Vol 6, Part B, 4.5.1).
    pub const MIN: Self = Self(6);
    /// The longest interval: 4 s.
    pub const MAX: Self = Self(3200);

    /// Returns the interval of `units` of 1.25 ms, or `None` if Bluetooth does not allow it.
    pub fn from_units(units: u16) -> Option<Self> {
        (Self::MIN.0..=Self::MAX.0)
            .contains(&units)
            .then_some(Self(units))
    }

    /// Returns the interval that is nearest to `span`.
    pub const fn nearest(span: Duration) -> Self {
        let units = (span.as_micros() + 625) / 1250;
        if units < Self::MIN.0 as u128 {
            Self::MIN
        } else if units > Self::MAX.0 as u128 {
            Self::MAX
        } else {
            Self(units as u16)
        }
    }

    /// Returns the interval in units of 1.25 ms.
    pub fn units(self) -> u16 {
        self.0
    }

    /// Returns the time between two events.
    pub fn duration(self) -> Duration {
        u32::from(self.0) * Duration::from_micros(1250)
    }

    /// Returns whether two links with these intervals can repeatedly need the same radio at the same time, if their
    /// events come from different clocks.
    ///
    /// Equal intervals do so for as long as the clocks need to drift apart. If one is a multiple of the other, the longer
    /// one does. Of two other intervals `a` and `b` with the greatest common divisor `g`, at most one event in `b / g` of
    /// the first overlaps, so single events are missed, and never many in a row.
    pub fn conflicts_with(self, other: Self) -> bool {
        self.0.min(other.0) / greatest_common_divisor(self.0, other.0) < MIN_RATIO
    }

    /// Returns the interval for a link: the one that conflicts with the fewest of `avoid`, and of several, the one that is
    /// nearest to `self`. The first `skip` of those are skipped, because they were tried before.
    pub fn choose(self, avoid: &[Self], skip: usize) -> Self {
        let conflicts = |interval: Self| {
            let in_conflict = |other: &&Self| interval.conflicts_with(**other);
            avoid.iter().filter(in_conflict).count()
        };
        let fewest = self.candidates().map(conflicts).min().unwrap_or(0);
        let best: Vec<_> = self
            .candidates()
            .filter(|interval| conflicts(*interval) == fewest)
            .collect();
        best.get(skip % best.len().max(1)).copied().unwrap_or(self)
    }

    /// Returns `self` and the intervals around it, the nearest first.
    fn candidates(self) -> impl Iterator<Item = Self> {
        let around = (1..=SPREAD).flat_map(move |step| {
            let longer = self.0.checked_add(step);
            [longer, self.0.checked_sub(step)]
        });
        std::iter::once(Some(self.0))
            .chain(around)
            .filter_map(|units| Self::from_units(units?))
    }
}

impl fmt::Display for ConnectionInterval {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ms", self.duration().as_secs_f64() * 1000.0)
    }
}

fn greatest_common_divisor(a: u16, b: u16) -> u16 {
    if b == 0 {
        a
    } else {
        greatest_common_divisor(b, a % b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn units(units: u16) -> ConnectionInterval {
        ConnectionInterval::from_units(units).expect("valid")
    }

    #[test]
    fn equal_intervals_and_multiples_conflict() {
        for (a, b) in [(24, 24), (6, 12), (12, 24), (16, 24)] {
            assert!(units(a).conflicts_with(units(b)), "{a} {b}");
            assert!(units(b).conflicts_with(units(a)), "{b} {a}");
        }
        for (a, b) in [(24, 25), (24, 23), (24, 26), (12, 9)] {
            assert!(!units(a).conflicts_with(units(b)), "{a} {b}");
        }
    }

    #[test]
    fn chooses_the_nearest_interval_without_conflict() {
        let base = units(24);
        assert_eq!(base.choose(&[], 0), base);
        assert_eq!(base.choose(&[base], 0), units(25));
        assert_eq!(base.choose(&[base, units(25)], 0), units(23));
        assert_eq!(base.choose(&[base], 1), units(23));
        assert_eq!(
            ConnectionInterval::MIN.choose(&[ConnectionInterval::MIN], 0),
            units(7)
        );
    }

    #[test]
    fn serves_two_robots_with_seven_links_each() {
        for base in [12, 24, 40] {
            let mut used = Vec::new();
            for _ in 0..13 {
                let next = units(base).choose(&used, 0);
                let in_conflict = used.iter().any(|other| next.conflicts_with(*other));
                // With 15 ms as the base, twelve intervals are free of conflicts.
                assert!(
                    !in_conflict || base == 12 && used.len() >= 7,
                    "{base}: {used:?}"
                );
                used.push(next);
            }
        }
    }

    #[test]
    fn converts_between_units_and_time() {
        assert_eq!(
            ConnectionInterval::nearest(Duration::from_millis(30)),
            units(24)
        );
        assert_eq!(units(25).duration(), Duration::from_micros(31_250));
        assert_eq!(units(25).to_string(), "31.25 ms");
        assert_eq!(ConnectionInterval::from_units(5), None);
        assert_eq!(ConnectionInterval::from_units(3201), None);
        assert_eq!(
            ConnectionInterval::nearest(Duration::ZERO),
            ConnectionInterval::MIN
        );
    }
}
