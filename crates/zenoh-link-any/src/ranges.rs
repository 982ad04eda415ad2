//! A set of byte ranges of a stream.
use std::{collections::BTreeMap, ops::Range};

/// A set of positions, kept as ranges that neither overlap nor touch.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Ranges(BTreeMap<u64, u64>);

impl Ranges {
    /// Adds a range.
    pub(crate) fn insert(&mut self, range: Range<u64>) {
        if range.is_empty() {
            return;
        }
        let (mut start, mut end) = (range.start, range.end);
        while let Some((&other_start, &other_end)) = self.0.range(..=end).next_back() {
            if other_end < start {
                break;
            }
            start = start.min(other_start);
            end = end.max(other_end);
            self.0.remove(&other_start);
        }
        self.0.insert(start, end);
    }

    /// Removes a range.
    pub(crate) fn remove(&mut self, range: &Range<u64>) {
        if range.is_empty() {
            return;
        }
        while let Some((&start, &end)) = self.0.range(..range.end).next_back() {
            if end <= range.start {
                break;
            }
            self.0.remove(&start);
            if end > range.end {
                self.0.insert(range.end, end);
            }
            if start < range.start {
                self.0.insert(start, range.start);
            }
        }
    }

    /// Returns whether the whole range is in the set.
    pub(crate) fn contains(&self, range: &Range<u64>) -> bool {
        range.is_empty() || self.end_at(range.start).is_some_and(|end| end >= range.end)
    }

    /// Returns the end of the range of the set that contains this position.
    pub(crate) fn end_at(&self, position: u64) -> Option<u64> {
        let (_, &end) = self.0.range(..=position).next_back()?;
        (end > position).then_some(end)
    }

    /// Returns the first range.
    pub(crate) fn first(&self) -> Option<Range<u64>> {
        self.0.iter().next().map(|(&start, &end)| start..end)
    }

    /// Returns the parts of a range that are not in the set.
    pub(crate) fn missing_from(&self, range: Range<u64>) -> Vec<Range<u64>> {
        let mut missing = Vec::new();
        let mut at = range.start;
        while at < range.end {
            if let Some(end) = self.end_at(at) {
                at = end;
                continue;
            }
            let next = self.0.range(at..range.end).next();
            let end = next.map_or(range.end, |(&start, _)| start);
            missing.push(at..end);
            at = end;
        }
        missing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with a set of single positions, for all pairs of ranges.
    #[test]
    fn behaves_like_a_set_of_positions() {
        let ranges = || (0..8).flat_map(|start| (start..8).map(move |end| start..end));
        for one in ranges() {
            for two in ranges() {
                for cut in ranges() {
                    let mut set = Ranges::default();
                    set.insert(one.clone());
                    set.insert(two.clone());
                    set.remove(&cut);
                    let is_in =
                        |n: u64| (one.contains(&n) || two.contains(&n)) && !cut.contains(&n);
                    for n in 0..8 {
                        assert_eq!(set.end_at(n).is_some(), is_in(n), "{one:?} {two:?} {cut:?}");
                    }
                    let missing: Vec<u64> = set.missing_from(0..8).into_iter().flatten().collect();
                    let expected: Vec<u64> = (0..8).filter(|n| !is_in(*n)).collect();
                    assert_eq!(missing, expected);
                    assert_eq!(
                        set.first().map(|first| first.start),
                        (0..8).find(|n| is_in(*n))
                    );
                    for range in ranges() {
                        assert_eq!(set.contains(&range), range.clone().all(is_in));
                    }
                }
            }
        }
    }
}
