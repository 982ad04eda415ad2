//! Implements sets of byte ranges, which describe the parts of a transfer that were received.
use std::ops::Range;

/// A set of bytes, stored as ranges in ascending order of which none is empty and no two are adjacent.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ranges(Vec<Range<u64>>);

impl Ranges {
    /// Returns the ranges in ascending order. None is empty, and no two are adjacent.
    pub fn iter(&self) -> impl Iterator<Item = Range<u64>> + '_ {
        self.0.iter().cloned()
    }

    /// Returns the number of ranges.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Returns the number of bytes.
    pub fn bytes(&self) -> u64 {
        self.0.iter().map(|range| range.end - range.start).sum()
    }

    /// Adds the bytes of a range, some of which may be in the set already.
    pub fn insert(&mut self, range: Range<u64>) {
        if range.is_empty() {
            return;
        }
        // The known ranges that touch the new one: from the first that does not end before it, to the last that does
        // not begin after it.
        let first = self.0.partition_point(|r| r.end < range.start);
        let last = self.0.partition_point(|r| r.start <= range.end);
        let merged = match self.0.get(first..last) {
            Some([one, .., other]) => range.start.min(one.start)..range.end.max(other.end),
            Some([one]) => range.start.min(one.start)..range.end.max(one.end),
            _ => range,
        };
        self.0.splice(first..last, [merged]);
    }

    /// Removes the bytes of a range.
    pub fn remove(&mut self, range: Range<u64>) {
        if range.is_empty() {
            return;
        }
        let first = self.0.partition_point(|r| r.end <= range.start);
        let last = self.0.partition_point(|r| r.start < range.end);
        let Some(hit) = self.0.get(first..last) else {
            return;
        };
        let before = hit.first().map(|r| r.start..range.start);
        let after = hit.last().map(|r| range.end..r.end);
        let left = before.into_iter().chain(after);
        let left: Vec<_> = left.filter(|r| r.start < r.end).collect();
        self.0.splice(first..last, left);
    }

    /// Returns whether all bytes of a range are in the set.
    pub fn contains(&self, range: &Range<u64>) -> bool {
        let after = self.0.partition_point(|r| r.start <= range.start);
        let range_before = after.checked_sub(1).and_then(|n| self.0.get(n));
        range.is_empty() || range_before.is_some_and(|r| r.end >= range.end)
    }

    /// Returns the first range of bytes that are not in the set, below `size_bytes`.
    pub fn first_gap(&self, size_bytes: u64) -> Option<Range<u64>> {
        let (start, end) = match self.0.as_slice() {
            [first, rest @ ..] if first.start == 0 => {
                (first.end, rest.first().map_or(size_bytes, |r| r.start))
            }
            [first, ..] => (0, first.start),
            [] => (0, size_bytes),
        };
        let end = end.min(size_bytes);
        (start < end).then_some(start..end)
    }

    /// Returns the end of the last range.
    pub fn end(&self) -> u64 {
        self.0.last().map_or(0, |range| range.end)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::transfer::simulated::Random;

    #[test]
    fn behaves_like_a_set_of_single_bytes() {
        for seed in 0..200 {
            let (mut random, mut ranges) = (Random::new(seed), Ranges::default());
            let mut bytes = BTreeSet::new();
            for _ in 0..60 {
                let start = random.below(40);
                let range = start..start + random.below(12);
                if random.below(3) == 0 {
                    ranges.remove(range.clone());
                    bytes.retain(|byte| !range.contains(byte));
                } else {
                    ranges.insert(range.clone());
                    bytes.extend(range.clone());
                }
                let listed: Vec<u64> = ranges.iter().flatten().collect();
                assert_eq!(
                    listed,
                    bytes.iter().copied().collect::<Vec<_>>(),
                    "seed {seed}"
                );
                let apart = ranges.0.windows(2).all(|two| two[0].end < two[1].start);
                assert!(
                    apart && ranges.iter().all(|r| !r.is_empty()),
                    "seed {seed}: {ranges:?}"
                );
                let gap = (0..45).find(|byte| !bytes.contains(byte));
                assert_eq!(
                    ranges.first_gap(45).map(|gap| gap.start),
                    gap,
                    "seed {seed}"
                );
                let all = range.clone().all(|byte| bytes.contains(&byte));
                assert_eq!(
                    ranges.contains(&range),
                    all,
                    "seed {seed}: {ranges:?} {range:?}"
                );
                assert_eq!(ranges.bytes(), bytes.len() as u64, "seed {seed}");
            }
        }
    }

    #[test]
    fn a_gap_ends_at_the_next_range() {
        let mut ranges = Ranges::default();
        assert_eq!(
            (ranges.first_gap(0), ranges.first_gap(9)),
            (None, Some(0..9))
        );
        ranges.insert(5..7);
        assert_eq!(
            (ranges.first_gap(9), ranges.first_gap(3)),
            (Some(0..5), Some(0..3))
        );
        ranges.insert(0..2);
        assert_eq!((ranges.first_gap(9), ranges.end()), (Some(2..5), 7));
        ranges.insert(2..9);
        assert_eq!(ranges.first_gap(9), None);
    }
}
