//! Decides what of a recording is replayed, and when.
use std::{collections::BTreeMap, time::Duration};

use rect_core::{
    action, alert,
    name::{topic::Topic, Name},
    parameters, stop,
};

use crate::{
    entry::{address, Entry, RetainedKind},
    entry_pattern::EntryPattern,
    remap::{remapped, Remap},
    retained::{LastValues, Repeats},
};

/// The part of a recording that is replayed, exported or copied.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// The topics. Empty: all.
    pub patterns: Vec<EntryPattern>,
    /// Where to begin, after the start of the recording.
    pub begin: Duration,
    /// Where to end, after the start of the recording. `None`: at its end.
    pub end: Option<Duration>,
}

impl Selection {
    /// Returns whether a message is among those that the patterns select.
    pub fn matches(&self, entry: &Entry) -> bool {
        self.patterns.is_empty()
            || self
                .patterns
                .iter()
                .any(|pattern| pattern.matches(&entry.topic))
    }
}

impl Selection {
    /// Returns the selected messages of a recording. The values that were retained before they begin are the first ones.
    pub fn of<E>(
        self,
        entries: impl Iterator<Item = Result<Entry, E>>,
    ) -> impl Iterator<Item = Result<Entry, E>> {
        let mut started = None;
        let mut earlier = Some(LastValues::default());
        let selected = entries.map_while(move |entry| {
            let entry: Entry = match entry {
                Ok(entry) => entry,
                Err(error) => return Some((Vec::new(), Some(Err(error)))),
            };
            let started = *started.get_or_insert(entry.logged);
            let begin = started + self.begin;
            let is_selected = self.matches(&entry);
            if let Some(earlier) = earlier.as_mut().filter(|_| entry.logged < begin) {
                if is_selected {
                    earlier.on_entry(entry);
                }
                return Some((Vec::new(), None));
            }
            let values = earlier
                .take()
                .map(|values| values.repeated(begin).collect());
            let values: Vec<_> = values.unwrap_or_default();
            let after = entry.logged.saturating_sub(started);
            match self.end.is_some_and(|end| after > end) {
                true => (!values.is_empty()).then_some((values, None)),
                false => Some((values, is_selected.then_some(Ok(entry)))),
            }
        });
        selected.flat_map(|(values, entry)| values.into_iter().map(Ok).chain(entry))
    }
}

/// Returns the messages of several recordings in the order of their times.
pub fn by_time<E, I: Iterator<Item = Result<Entry, E>>>(
    recordings: Vec<I>,
) -> impl Iterator<Item = Result<Entry, E>> {
    let mut recordings: Vec<_> = recordings.into_iter().map(Iterator::peekable).collect();
    let count = recordings.len();
    let mut repeats = Repeats::default();
    std::iter::from_fn(move || {
        // An error is reported at once, and a recording that has ended is last.
        let mut time = |n: &usize| match recordings.get_mut(*n)?.peek()? {
            Ok(entry) => Some(entry.logged),
            Err(_) => Some(Duration::ZERO),
        };
        let earliest = (0..count).min_by_key(|n| time(n).unwrap_or(Duration::MAX))?;
        recordings.get_mut(earliest)?.next()
    })
    .filter(move |entry| !matches!(entry, Ok(entry) if repeats.is_known(entry)))
}

/// A message to publish.
#[derive(Clone, Debug, PartialEq)]
pub struct Due {
    /// When, after the beginning of the replay, at the rate of the recording.
    pub at: Duration,
    /// The robot that publishes it.
    pub robot: Name,
    /// The topic.
    pub topic: Topic,
    /// The message.
    pub entry: Entry,
}

/// Turns the messages of a recording into those to publish, in the same order.
pub struct Replay<I> {
    entries: I,
    selection: Selection,
    remaps: Vec<Remap>,
    /// The robot that publishes everything. `None`: those of the recording.
    robot: Option<Name>,
    started: Option<Duration>,
    /// The last message of each topic before the beginning, which a program that joins late would know.
    earlier: BTreeMap<String, Entry>,
    /// The first message after the beginning, while the earlier ones are returned.
    held: Option<Entry>,
    /// The topics that are not those of a robot, and the numbers of their messages.
    skipped: BTreeMap<String, u64>,
    /// Whether the robot is a real one, whose programs and router retain values of their own.
    is_live: bool,
    left_out: u64,
}

impl<E, I: Iterator<Item = Result<Entry, E>>> Replay<I> {
    /// Replays `entries` under the names that `remaps` gives them, or as messages of `robot`.
    pub fn new(entries: I, selection: Selection, remaps: Vec<Remap>, robot: Option<Name>) -> Self {
        Self {
            entries,
            selection,
            remaps,
            robot,
            started: None,
            earlier: BTreeMap::new(),
            held: None,
            skipped: BTreeMap::new(),
            is_live: false,
            left_out: 0,
        }
    }

    /// Leaves out what a real robot says about itself by retained topics: its parameters, goals and alerts, and the stop of the fleet.
    #[must_use]
    pub fn as_live_robot(self) -> Self {
        Self {
            is_live: true,
            ..self
        }
    }

    /// Returns how many messages were left out because the robot is a real one.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Returns the topics so far that are not those of a robot, and how many messages each of them had.
    pub fn skipped(&self) -> &BTreeMap<String, u64> {
        &self.skipped
    }

    fn next_entry(&mut self) -> Result<Option<Entry>, E> {
        loop {
            if self.held.is_some() {
                return Ok(match self.earlier.pop_first() {
                    Some((_, entry)) => Some(entry),
                    None => self.held.take(),
                });
            }
            let Some(entry) = self.entries.next().transpose()? else {
                // The recording ended before the beginning.
                return Ok(None);
            };
            let started = *self.started.get_or_insert(entry.logged);
            if entry.is_report() || !self.selection.matches(&entry) {
                continue;
            }
            let after = entry.logged.saturating_sub(started);
            let is_forgotten = entry.retained == Some(RetainedKind::Forgotten);
            if after < self.selection.begin && is_forgotten {
                self.earlier.remove(&entry.topic);
            } else if after < self.selection.begin {
                self.earlier.insert(entry.topic.clone(), entry);
            } else if self.selection.end.is_some_and(|end| after > end) {
                return Ok(None);
            } else {
                self.held = Some(entry);
            }
        }
    }

    fn due(&self, entry: Entry) -> Option<Due> {
        let started = self.started.unwrap_or_default() + self.selection.begin;
        let at = entry.logged.saturating_sub(started);
        let name = remapped(&self.remaps, &entry.topic);
        // Other programs begin their topics with a slash, and none of the parts is a robot: /left/image and /right/image differ.
        let is_whole = self.robot.is_some() && entry.topic.starts_with('/');
        let (robot, topic) = match (&self.robot, address(&name).filter(|_| !is_whole)) {
            (None, address) => address?,
            (Some(robot), Some((_, topic))) => (robot.clone(), topic),
            (Some(robot), None) => (robot.clone(), Topic::new(&name).ok()?),
        };
        Some(Due {
            at,
            robot,
            topic,
            entry,
        })
    }
}

impl<E, I: Iterator<Item = Result<Entry, E>>> Iterator for Replay<I> {
    type Item = Result<Due, E>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let entry = match self.next_entry() {
                Ok(entry) => entry?,
                Err(error) => return Some(Err(error)),
            };
            let topic = entry.topic.clone();
            match self.due(entry) {
                Some(due) if self.is_live && is_of_robot(&due) => self.left_out += 1,
                Some(due) => return Some(Ok(due)),
                None => *self.skipped.entry(topic).or_default() += 1,
            }
        }
    }
}

/// Returns whether a message is a value by which a robot says how it is.
fn is_of_robot(due: &Due) -> bool {
    let topic = due.topic.as_str();
    let (alerts, _) = alert::TOPICS.split_once('/').unwrap_or_default();
    let first = topic.split('/').next().unwrap_or_default();
    due.entry.retained.is_some()
        && (topic == stop::TOPIC || [action::TOPIC, parameters::TOPIC, alerts].contains(&first))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rect_core::message::{encoding::Encoding, payload::Payload, urgency::Urgency};

    fn entry(topic: &str, ms: u64) -> Result<Entry, ()> {
        Ok(Entry {
            topic: topic.to_owned(),
            recipient: None,
            payload: Payload::new(ms.to_string(), Encoding::TEXT),
            urgency: Urgency::Normal,
            sequence: 0,
            publisher: None,
            logged: Duration::from_millis(1_000_000 + ms),
            sent: Duration::ZERO,
            retained: None,
            foreign: None,
        })
    }

    fn replayed(
        selection: Selection,
        remap: &str,
        robot: Option<&str>,
    ) -> Vec<(String, u64, String)> {
        let recorded = [
            entry("a/x", 0),
            entry("a/y", 100),
            entry("b/x", 200),
            entry("no-robot", 250),
            entry("a/x", 300),
            entry("a/x", 400),
        ];
        let robot = robot.map(|name| Name::new(name).expect("a name"));
        let remaps = remap.parse().into_iter().collect();
        let replay = Replay::new(recorded.into_iter(), selection, remaps, robot);
        replay
            .map(|due| due.expect("no error"))
            .map(|due| {
                let topic = format!("{}/{}", due.robot, due.topic.as_str());
                let text = due.entry.payload.text().expect("text").to_owned();
                (topic, due.at.as_millis() as u64, text)
            })
            .collect()
    }

    fn expected(rows: &[(&str, u64, &str)]) -> Vec<(String, u64, String)> {
        let owned = |(topic, at, text): &(&str, u64, &str)| ((*topic).into(), *at, (*text).into());
        rows.iter().map(owned).collect()
    }

    #[test]
    fn messages_keep_their_distances_and_robots() {
        let all = replayed(Selection::default(), "b=c", None);
        let rows = [
            ("a/x", 0, "0"),
            ("a/y", 100, "100"),
            ("c/x", 200, "200"),
            ("a/x", 300, "300"),
            ("a/x", 400, "400"),
        ];
        assert_eq!(all, expected(&rows));
    }

    #[test]
    fn range_begins_with_the_last_value_of_each_topic() {
        let ms = Duration::from_millis;
        let selection = Selection {
            patterns: vec!["a/*".parse().expect("a pattern")],
            begin: ms(250),
            end: Some(ms(350)),
        };
        let rows = [("a/x", 0, "0"), ("a/y", 0, "100"), ("a/x", 50, "300")];
        assert_eq!(replayed(selection, "", None), expected(&rows));
    }

    #[test]
    fn part_begins_with_the_values_that_were_retained_before() {
        use RetainedKind::{Forgotten, Repeated, Value};
        let kept = |topic, ms, kind| {
            let retained = Some(kind);
            entry(topic, ms).map(|entry| Entry { retained, ..entry })
        };
        let recorded = [
            kept("a/mode", 0, Value),
            kept("a/map", 50, Value),
            kept("b/mode", 60, Value),
            entry("a/x", 100),
            kept("a/map", 200, Forgotten),
            kept("a/mode", 250, Value),
            entry("a/x", 300),
            kept("a/mode", 400, Value),
            entry("a/x", 500),
        ];
        let part = |begin, end| {
            let selection = Selection {
                patterns: vec!["a/*".parse().expect("a pattern")],
                begin: Duration::from_millis(begin),
                end: Some(Duration::from_millis(end)),
            };
            let entries = selection.of(recorded.clone().into_iter());
            let rows = entries.map(|entry| {
                let entry = entry.expect("no error");
                let at = entry.logged.as_millis() as u64 - 1_000_000;
                let text = entry.payload.text().expect("text").to_owned();
                (entry.topic, at, text, entry.retained)
            });
            rows.collect::<Vec<_>>()
        };
        let row = |topic: &str, at, text: &str, kind| (topic.to_owned(), at, text.to_owned(), kind);
        let old = row("a/mode", 150, "0", Some(Repeated));
        let map = row("a/map", 150, "50", Some(Repeated));
        assert_eq!(part(150, 160), [map, old]);
        let mode = row("a/mode", 260, "250", Some(Repeated));
        let x = row("a/x", 300, "300", None);
        assert_eq!(part(260, 350), [mode, x]);
        assert_eq!(part(0, 40), [row("a/mode", 0, "0", Some(Value))]);
    }

    #[test]
    fn topics_of_other_programs_stay_apart_under_one_robot() {
        let recorded = [
            entry("/left/image", 0),
            entry("/right/image", 10),
            entry("/odom", 20),
        ];
        let robot = Some(Name::new("replay").expect("a name"));
        let mut replay = Replay::new(
            recorded.into_iter(),
            Selection::default(),
            Vec::new(),
            robot,
        );
        let topics = replay
            .by_ref()
            .map(|due| due.expect("no error").topic.to_string());
        assert_eq!(
            topics.collect::<Vec<_>>(),
            ["left/image", "right/image", "odom"]
        );
        let alone = [entry("/odom", 0), entry("odom", 1), entry("/odom", 2)];
        let mut replay = Replay::new(alone.into_iter(), Selection::default(), Vec::new(), None);
        assert_eq!(replay.by_ref().count(), 0);
        let skipped = [("/odom".to_owned(), 2), ("odom".to_owned(), 1)];
        assert_eq!(*replay.skipped(), BTreeMap::from(skipped));
    }

    #[test]
    fn values_of_a_real_robot_are_not_replaced() {
        let retained = |topic| {
            entry(topic, 0).map(|entry| Entry {
                retained: Some(RetainedKind::Value),
                ..entry
            })
        };
        let recorded = [
            retained("a/mode"),
            retained("a/actions/dig/7f"),
            entry("a/actions/dig/7f/feedback", 0),
            retained("a/parameters/drive"),
            retained("a/alerts/battery"),
            retained("a/stop/state"),
            retained("a/stop/button"),
        ];
        let robot = || Some(Name::new("wombat").expect("a name"));
        let replay = || {
            let (recorded, selection) = (recorded.clone().into_iter(), Selection::default());
            Replay::new(recorded, selection, Vec::new(), robot())
        };
        assert_eq!(replay().count(), recorded.len());
        let mut live = replay().as_live_robot();
        let topics: Vec<_> = live
            .by_ref()
            .map(|due| due.expect("no error").topic)
            .collect();
        let topics: Vec<_> = topics.iter().map(Topic::as_str).collect();
        assert_eq!(topics, ["mode", "actions/dig/7f/feedback", "stop/button"]);
        assert_eq!(live.left_out(), 4);
    }

    #[test]
    fn another_robot_publishes_everything() {
        let all = replayed(Selection::default(), "", Some("replay"));
        let topics: Vec<_> = all.iter().map(|(topic, ..)| topic.as_str()).collect();
        let x = "replay/x";
        assert_eq!(topics, [x, "replay/y", x, "replay/no-robot", x, x]);
    }
}
