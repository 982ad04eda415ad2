//! Retained topics in a recording. Each file begins with the values that were retained before it, so that it is complete without the files
//! before it. A program that reads several files gets each value once.
use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use crate::entry::{Entry, RetainedKind};

/// The maximum size of the values at the beginning of a file, in bytes. Further ones are not repeated.
const MAX_BYTES: usize = 1 << 20;

/// The last values of the retained topics of a recording.
#[derive(Debug, Default)]
pub struct LastValues {
    entries: BTreeMap<String, Entry>,
    bytes: usize,
}

impl LastValues {
    /// Handles an entry of the recording.
    pub fn on_entry(&mut self, entry: Entry) {
        let Some(kind) = entry.retained else { return };
        if let Some(previous) = self.entries.remove(&entry.topic) {
            self.bytes -= previous.bytes();
        }
        let bytes = self.bytes + entry.bytes();
        if kind != RetainedKind::Forgotten && bytes <= MAX_BYTES {
            self.bytes = bytes;
            self.entries.insert(entry.topic.clone(), entry);
        }
    }

    /// Returns the values for the beginning of a file.
    pub fn repeated(&self, logged: Duration) -> impl Iterator<Item = Entry> + '_ {
        self.entries.values().map(move |entry| Entry {
            logged,
            retained: Some(RetainedKind::Repeated),
            ..entry.clone()
        })
    }

    /// Returns about how many bytes the values have.
    pub fn bytes(&self) -> usize {
        self.bytes
    }
}

/// Recognises the values that are repeated at the beginning of a file, and that were read in a file before it.
#[derive(Debug, Default)]
pub struct Repeats {
    topics: BTreeSet<String>,
}

impl Repeats {
    /// Returns whether an entry, which follows those before it, has nothing new.
    pub fn is_known(&mut self, entry: &Entry) -> bool {
        match entry.retained {
            None => false,
            Some(RetainedKind::Repeated) if self.topics.contains(&entry.topic) => true,
            Some(_) => {
                if !self.topics.contains(&entry.topic) {
                    self.topics.insert(entry.topic.clone());
                }
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rect_core::{
        message::{encoding::Encoding, payload::Payload, Message},
        name::{topic::Topic, Name},
    };

    use super::*;

    fn entry(topic: &str, size: usize, retained: Option<RetainedKind>) -> Entry {
        let (robot, topic) = (Name::new("a"), Topic::new(topic));
        let (robot, topic) = (robot.expect("a name"), topic.expect("a topic"));
        let payload = Payload::new(vec![0; size], Encoding::BYTES);
        Entry {
            retained,
            ..Entry::of(Message::new(robot, topic, payload), Duration::ZERO)
        }
    }

    #[test]
    fn last_values_are_bounded_and_forgotten() {
        use RetainedKind::{Forgotten, Value};
        let mut values = LastValues::default();
        let topics = |values: &LastValues| {
            let all = values.repeated(Duration::from_secs(7));
            let all = all.inspect(|entry| assert_eq!(entry.logged, Duration::from_secs(7)));
            all.map(|entry| entry.topic).collect::<Vec<_>>()
        };
        values.on_entry(entry("plain", 1, None));
        values.on_entry(entry("mode", 1, Some(Value)));
        values.on_entry(entry("map", MAX_BYTES / 2, Some(Value)));
        assert_eq!(topics(&values), ["a/map", "a/mode"]);
        values.on_entry(entry("map", MAX_BYTES, Some(Value)));
        assert_eq!(topics(&values), ["a/mode"], "no older value instead");
        values.on_entry(entry("mode", 0, Some(Forgotten)));
        assert!(topics(&values).is_empty());
        assert_eq!(values.bytes(), 0);
    }

    #[test]
    fn repeated_value_is_known_after_any_entry_of_its_topic() {
        use RetainedKind::{Forgotten, Repeated, Value};
        for before in [Value, Repeated, Forgotten] {
            let mut repeats = Repeats::default();
            assert!(!repeats.is_known(&entry("mode", 1, Some(before))));
            assert!(repeats.is_known(&entry("mode", 1, Some(Repeated))));
            assert!(!repeats.is_known(&entry("other", 1, Some(Repeated))));
            assert!(!repeats.is_known(&entry("mode", 1, Some(Value))));
        }
    }
}
