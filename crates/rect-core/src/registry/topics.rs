//! Counts the messages of a robot's topics for its router, and builds the router's answers about them. The caller
//! passes the time. docs/reference/registry.md describes the form of the answers.
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    hash::{DefaultHasher, Hash, Hasher},
    time::{Duration, Instant},
};

use serde::{Deserialize, Serialize};

use super::usage::LinkUsage;
use crate::message::sequence::{Order, Sequence};

/// The time before a question over which rates are measured.
pub const WINDOW: Duration = Duration::from_secs(5);
/// The maximum number of topics that are counted individually. Of further topics, only their number is reported.
pub const MAX_TOPICS: usize = 256;
/// The largest number of further topics that is reported.
const MAX_MORE: usize = 10_000;
/// The number of parts into which the window is divided.
const BUCKETS: u32 = 10;
const BUCKET: Duration = Duration::from_millis(500);
/// The maximum length of an encoding in a report, in bytes.
const MAX_ENCODING_BYTES: usize = 64;
/// The maximum length of a topic that is counted, in bytes.
const MAX_TOPIC_BYTES: usize = 220;
/// The maximum number of publishers of a topic whose sequence numbers are followed.
const MAX_PUBLISHERS: usize = 16;

/// The part of RECT's internal keys under which a router answers questions about its robot's topics.
pub const TOPICS: &str = "topics";
/// The parameter that selects a single topic.
pub const TOPIC: &str = "topic";
/// The parameter that says for how many seconds to count messages after a question.
pub const KEEP: &str = "keep_s";
/// The time for which messages are counted after a question that does not say.
pub const KEPT: Duration = Duration::from_secs(5);
/// The longest time for which messages are counted after a question.
pub const MAX_KEPT: Duration = Duration::from_secs(30);

/// A router's answer about the topics of its robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "Document", into = "Document")]
pub struct Topics {
    /// The time over which messages have been counted, in seconds, at most [`WINDOW`]. 0 in the answer that starts the count.
    pub window_s: f64,
    /// The topics, in the order of their names.
    pub topics: Vec<TopicReport>,
    /// The number of topics that are not in the list.
    pub more: usize,
    /// The bytes that the robot's `ble` and `any` links have sent, also for other robots.
    pub links: Vec<LinkUsage>,
}

/// The form of an answer in JSON.
#[derive(Serialize, Deserialize)]
struct Document {
    window_s: f64,
    topics: Vec<Row>,
    #[serde(default, skip_serializing_if = "is_zero")]
    more: usize,
    /// The positions in `topics` of those that are retained. They are not in the rows, whose lengths are fixed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    retained: Vec<usize>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    links: Vec<LinkUsage>,
}

impl From<Document> for Topics {
    fn from(document: Document) -> Self {
        let mut topics: Vec<_> = (document.topics.into_iter())
            .map(TopicReport::from)
            .collect();
        for at in document.retained {
            if let Some(report) = topics.get_mut(at) {
                report.is_retained = true;
            }
        }
        Self {
            window_s: document.window_s,
            topics,
            more: document.more,
            links: document.links,
        }
    }
}

impl From<Topics> for Document {
    fn from(topics: Topics) -> Self {
        let numbered = topics.topics.iter().enumerate();
        let retained = numbered.filter(|(_, report)| report.is_retained);
        Self {
            window_s: topics.window_s,
            retained: retained.map(|(at, _)| at).collect(),
            topics: topics.topics.into_iter().map(Row::from).collect(),
            more: topics.more,
            links: topics.links,
        }
    }
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// The report about one topic. In JSON it is an array of the fields in this order, to save bytes, except for the last one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopicReport {
    /// The topic: the key below the robot's name.
    pub topic: String,
    /// The encoding of the last message, at most its first 64 bytes. Empty if no message was counted.
    pub encoding: String,
    /// Messages per second.
    pub hz: f64,
    /// Payload bytes per second.
    pub bytes_per_s: u64,
    /// The size of the last payload, in bytes.
    pub last_bytes: u64,
    /// The number of messages that did not reach the robot's own router since the count began, by their sequence numbers.
    pub lost: u64,
    /// The shortest and the longest interval between two messages, in milliseconds. `None` if the question does
    /// not select a single topic, or if no interval ended within the window.
    pub interval_ms: Option<(f64, f64)>,
    /// Whether the router keeps the topic's last value.
    pub is_retained: bool,
}

/// A retained topic of a robot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RetainedTopic {
    /// The topic.
    pub topic: String,
    /// The encoding of its value.
    pub encoding: String,
    /// The size of its value, in bytes.
    pub bytes: u64,
}

/// A report with what is not always there: the losses, and the intervals.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Row {
    LossyLong(String, String, f64, u64, u64, u64, (f64, f64)),
    Long(String, String, f64, u64, u64, (f64, f64)),
    Lossy(String, String, f64, u64, u64, u64),
    Short(String, String, f64, u64, u64),
}

impl From<Row> for TopicReport {
    fn from(row: Row) -> Self {
        let (topic, encoding, hz, bytes_per_s, last_bytes, lost, interval_ms) = match row {
            Row::LossyLong(topic, encoding, hz, rate, last, lost, intervals) => {
                (topic, encoding, hz, rate, last, lost, Some(intervals))
            }
            Row::Long(topic, encoding, hz, rate, last, intervals) => {
                (topic, encoding, hz, rate, last, 0, Some(intervals))
            }
            Row::Lossy(topic, encoding, hz, rate, last, lost) => {
                (topic, encoding, hz, rate, last, lost, None)
            }
            Row::Short(topic, encoding, hz, rate, last) => {
                (topic, encoding, hz, rate, last, 0, None)
            }
        };
        Self {
            topic,
            encoding,
            hz,
            bytes_per_s,
            last_bytes,
            lost,
            interval_ms,
            is_retained: false,
        }
    }
}

impl From<TopicReport> for Row {
    fn from(report: TopicReport) -> Self {
        let TopicReport {
            topic,
            encoding,
            hz,
            bytes_per_s: rate,
            last_bytes: last,
            lost,
            interval_ms,
            is_retained: _,
        } = report;
        match (lost, interval_ms) {
            (0, Some(intervals)) => Self::Long(topic, encoding, hz, rate, last, intervals),
            (0, None) => Self::Short(topic, encoding, hz, rate, last),
            (lost, Some(intervals)) => {
                Self::LossyLong(topic, encoding, hz, rate, last, lost, intervals)
            }
            (lost, None) => Self::Lossy(topic, encoding, hz, rate, last, lost),
        }
    }
}

/// Counts messages from its creation on.
#[derive(Debug)]
pub struct Counter {
    start: Instant,
    topics: BTreeMap<String, Counted>,
    /// The hashes of the topics that could not be counted individually, because of the limit or their length.
    uncounted: BTreeSet<u64>,
}

#[derive(Debug, Default)]
struct Counted {
    buckets: VecDeque<Bucket>,
    encoding: String,
    last_bytes: u64,
    last: Option<Instant>,
    /// The last sequence number of each publisher.
    sequences: BTreeMap<u16, Sequence>,
    lost: u64,
}

/// The messages within one part of the window.
#[derive(Clone, Copy, Debug, Default)]
struct Bucket {
    number: u128,
    /// The time of its first message.
    first: Option<Instant>,
    messages: u64,
    bytes: u64,
    /// The shortest and the longest interval that ended in this part.
    intervals: Option<(Duration, Duration)>,
}

impl Counter {
    /// Creates a counter.
    pub fn new(now: Instant) -> Self {
        Self {
            start: now,
            topics: BTreeMap::new(),
            uncounted: BTreeSet::new(),
        }
    }

    /// Counts a message. `number` is the number of its publisher and its sequence number, if it has them.
    pub fn on_message(
        &mut self,
        now: Instant,
        topic: &str,
        payload_bytes: usize,
        encoding: &str,
        numbers: Option<(u16, u32)>,
    ) {
        let number = self.bucket(now);
        let is_counted = self.topics.contains_key(topic);
        if !is_counted && (self.topics.len() >= MAX_TOPICS || topic.len() > MAX_TOPIC_BYTES) {
            if self.uncounted.len() < MAX_MORE {
                let mut hasher = DefaultHasher::new();
                topic.hash(&mut hasher);
                self.uncounted.insert(hasher.finish());
            }
            return;
        }
        if !is_counted {
            self.topics.insert(topic.to_owned(), Counted::default());
        }
        if let Some(counted) = self.topics.get_mut(topic) {
            counted.on_message(now, number, payload_bytes as u64, encoding);
            if let Some((publisher, sequence)) = numbers {
                counted.on_sequence(publisher, sequence);
            }
        }
    }

    /// Returns the answer at `now`. `topic` selects a single topic; only then does the answer include the intervals.
    pub fn report(&self, now: Instant, topic: Option<&str>) -> Topics {
        let window = now.saturating_duration_since(self.start).min(WINDOW);
        let oldest = self.bucket(now).saturating_sub(u128::from(BUCKETS));
        let selected = self
            .topics
            .iter()
            .filter(|(name, _)| topic.is_none_or(|topic| *name == topic));
        let topics = selected.map(|(name, counted)| {
            let report = counted.report(name, now, window, oldest);
            TopicReport {
                interval_ms: report.interval_ms.filter(|_| topic.is_some()),
                ..report
            }
        });
        Topics {
            window_s: tenths(window.as_secs_f64()),
            topics: topics.collect(),
            more: self.uncounted.len(),
            links: Vec::new(),
        }
    }

    fn bucket(&self, now: Instant) -> u128 {
        now.saturating_duration_since(self.start).as_millis() / BUCKET.as_millis()
    }
}

impl Counted {
    fn on_message(&mut self, now: Instant, number: u128, bytes: u64, encoding: &str) {
        if self
            .buckets
            .back()
            .is_none_or(|bucket| bucket.number != number)
        {
            self.buckets.push_back(Bucket {
                number,
                ..Bucket::default()
            });
            // Keeps the part that is being filled, and those of the window before it.
            while self.buckets.len() > BUCKETS as usize + 1 {
                self.buckets.pop_front();
            }
        }
        let interval = self.last.map(|last| now.saturating_duration_since(last));
        if let Some(bucket) = self.buckets.back_mut() {
            bucket.first.get_or_insert(now);
            bucket.messages += 1;
            bucket.bytes += bytes;
            bucket.intervals = match (bucket.intervals, interval) {
                (Some((min, max)), Some(one)) => Some((min.min(one), max.max(one))),
                (None, Some(one)) => Some((one, one)),
                (known, None) => known,
            };
        }
        self.last = Some(now);
        self.last_bytes = bytes;
        if self.encoding != encoding {
            self.encoding = shortened(encoding).to_owned();
        }
    }

    /// Counts the messages of a publisher that are missing before this one. One that was overtaken is missing no more.
    fn on_sequence(&mut self, publisher: u16, sequence: u32) {
        let Some(known) = self.sequences.get_mut(&publisher) else {
            if self.sequences.len() < MAX_PUBLISHERS {
                self.sequences.insert(publisher, Sequence::new(sequence));
            }
            return;
        };
        match known.on_message(sequence) {
            Order::Next { missed } => self.lost += u64::from(missed),
            Order::Repeated => {}
            Order::Late => self.lost = self.lost.saturating_sub(1),
            Order::Renumbered { miscounted } => {
                self.lost = self.lost.saturating_sub(miscounted.into());
            }
        }
    }

    fn report(&self, topic: &str, now: Instant, window: Duration, oldest: u128) -> TopicReport {
        let buckets = || self.buckets.iter().filter(|bucket| bucket.number >= oldest);
        let messages: u64 = buckets().map(|bucket| bucket.messages).sum();
        let bytes: u64 = buckets().map(|bucket| bucket.bytes).sum();
        let intervals = buckets().filter_map(|bucket| bucket.intervals);
        let intervals = intervals.reduce(|(a, b), (c, d)| (a.min(c), b.max(d)));
        // Over less than one part, the rate would be that of a single message.
        let seconds = window.max(BUCKET).as_secs_f64();
        let hz = match (buckets().find_map(|bucket| bucket.first), self.last) {
            (Some(first), Some(last)) if messages > 1 && last > first => {
                let mean = (last - first).div_f64((messages - 1) as f64);
                // The rate of a topic that has stopped publishing decreases from then on.
                let is_quiet = now.saturating_duration_since(last) > 2 * mean;
                if is_quiet {
                    messages as f64 / seconds
                } else {
                    1.0 / mean.as_secs_f64()
                }
            }
            _ => messages as f64 / seconds,
        };
        TopicReport {
            topic: topic.to_owned(),
            encoding: self.encoding.clone(),
            hz: tenths(hz),
            bytes_per_s: (bytes as f64 / seconds).round() as u64,
            last_bytes: self.last_bytes,
            lost: self.lost,
            interval_ms: intervals.map(|(min, max)| (tenths_ms(min), tenths_ms(max))),
            is_retained: false,
        }
    }
}

impl Topics {
    /// Marks the topics that are retained, and adds those of which no message was counted. `topic` selects a single topic.
    #[must_use]
    pub fn with_retained(
        mut self,
        retained: impl IntoIterator<Item = RetainedTopic>,
        topic: Option<&str>,
    ) -> Self {
        let selected = |one: &RetainedTopic| topic.is_none_or(|topic| one.topic == topic);
        for one in retained.into_iter().filter(selected) {
            let at = (self.topics).binary_search_by(|report| report.topic.cmp(&one.topic));
            match at {
                Ok(at) => self.topics[at].is_retained = true,
                Err(_) if self.topics.len() >= MAX_TOPICS => self.more += 1,
                Err(at) => {
                    let report = TopicReport {
                        encoding: shortened(&one.encoding).to_owned(),
                        topic: one.topic,
                        last_bytes: one.bytes,
                        is_retained: true,
                        ..TopicReport::default()
                    };
                    self.topics.insert(at, report);
                }
            }
        }
        self
    }
}

/// Returns the beginning of an encoding that a report contains.
fn shortened(encoding: &str) -> &str {
    let end = encoding.char_indices().map(|(at, c)| at + c.len_utf8());
    let end = end.take_while(|&end| end <= MAX_ENCODING_BYTES).last();
    &encoding[..end.unwrap_or(0)]
}

fn tenths(number: f64) -> f64 {
    (number * 10.0).round() / 10.0
}

fn tenths_ms(time: Duration) -> f64 {
    tenths(time.as_secs_f64() * 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// Returns a counter that has counted a message of 24 bytes every 100 ms for `ms`, and the time after that.
    fn counted(ms: u32) -> (Counter, Instant) {
        let start = Instant::now();
        let mut counter = Counter::new(start);
        for at in (100..=ms).step_by(100) {
            counter.on_message(start + at * MS, "arm/angle", 24, "application/json", None);
        }
        (counter, start + ms * MS)
    }

    #[test]
    fn reports_the_rate_of_the_last_seconds() {
        for ms in [2_000, 5_000, 60_000] {
            let (counter, now) = counted(ms);
            let report = counter.report(now, None);
            let one = &report.topics[0];
            assert_eq!(one.hz, 10.0, "{ms}: {one:?}");
            assert!((220..=280).contains(&one.bytes_per_s), "{ms}: {one:?}");
            assert_eq!(
                (one.last_bytes, one.encoding.as_str()),
                (24, "application/json")
            );
        }
    }

    #[test]
    fn a_topic_that_stopped_publishing_has_no_rate() {
        let (counter, now) = counted(3_000);
        let report = counter.report(now + 2 * WINDOW, None);
        assert_eq!(
            (report.topics[0].hz, report.topics[0].last_bytes),
            (0.0, 24)
        );
    }

    #[test]
    fn the_rate_of_a_slow_topic_follows_from_its_intervals() {
        let start = Instant::now();
        let mut counter = Counter::new(start);
        for second in 1..=4 {
            counter.on_message(start + second * 1000 * MS, "slow", 1, "", None);
        }
        let hz = |ms: u32| counter.report(start + ms * MS, None).topics[0].hz;
        assert_eq!(hz(4_400), 1.0);
        assert!(hz(8_500) < 0.5, "stopped publishing");
    }

    #[test]
    fn reports_intervals_only_for_a_selected_topic() {
        let (mut counter, now) = counted(2_000);
        counter.on_message(now + 250 * MS, "arm/angle", 24, "application/json", None);
        let report = counter.report(now + 300 * MS, Some("arm/angle"));
        assert_eq!(report.topics[0].interval_ms, Some((100.0, 250.0)));
        let all = counter.report(now + 300 * MS, None);
        assert_eq!(all.topics[0].interval_ms, None);
        assert!(counter.report(now, Some("other")).topics.is_empty());
    }

    #[test]
    fn counts_messages_that_did_not_arrive_for_each_publisher() {
        let start = Instant::now();
        let mut counter = Counter::new(start);
        for (publisher, sequence) in [(1, 7), (2, u32::MAX), (1, 8), (1, 11), (2, 1), (1, 10)] {
            let numbers = Some((publisher, sequence));
            counter.on_message(start + MS, "pose", 1, "", numbers);
        }
        let report = counter.report(start + MS, None);
        assert_eq!(report.topics[0].lost, 2, "9 of the first, 0 of the second");
        let json = serde_json::to_string(&report).expect("JSON");
        let back: Topics = serde_json::from_str(&json).expect("valid JSON");
        assert_eq!(back, report);
        let one = counter.report(start + MS, Some("pose"));
        let json = serde_json::to_string(&one).expect("JSON");
        let back: Topics = serde_json::from_str(&json).expect("valid JSON");
        assert_eq!(back, one);
    }

    #[test]
    fn retained_topics_are_marked_and_listed_without_a_message() {
        let retained = ["zone", "arm/angle", "mode"].map(|topic| RetainedTopic {
            topic: topic.to_owned(),
            encoding: "e".repeat(2 * MAX_ENCODING_BYTES),
            bytes: 6,
        });
        let (counter, now) = counted(2_000);
        let report = |topic| {
            let report = counter.report(now, topic);
            report.with_retained(retained.clone(), topic)
        };
        let all = report(None);
        let rows = |topics: &Topics| {
            let rows = topics.topics.iter();
            let rows = rows.map(|one| (one.topic.clone(), one.last_bytes, one.is_retained));
            rows.collect::<Vec<_>>()
        };
        let expected = [("arm/angle", 24), ("mode", 6), ("zone", 6)];
        assert_eq!(
            rows(&all),
            expected.map(|(topic, bytes)| (topic.to_owned(), bytes, true))
        );
        assert_eq!(all.topics[1].encoding.len(), MAX_ENCODING_BYTES);
        assert_eq!(rows(&report(Some("mode"))), [("mode".to_owned(), 6, true)]);
        assert!(rows(&report(Some("other"))).is_empty());

        let json = serde_json::to_string(&all).expect("JSON");
        assert!(json.ends_with(r#""retained":[0,1,2]}"#), "{json}");
        let back: Topics = serde_json::from_str(&json).expect("valid JSON");
        assert_eq!(back, all);
        let hostile = json.replace("[0,1,2]", "[7,1,1]");
        let back: Topics = serde_json::from_str(&hostile).expect("valid JSON");
        let marked = back.topics.iter().filter(|one| one.is_retained).count();
        assert_eq!(marked, 1, "{hostile}");
    }

    #[test]
    fn retained_topics_beyond_the_maximum_are_counted() {
        let retained = (0..MAX_TOPICS + 3).map(|n| RetainedTopic {
            topic: format!("t{n}"),
            encoding: String::new(),
            bytes: 1,
        });
        let topics = Topics::default().with_retained(retained, None);
        assert_eq!((topics.topics.len(), topics.more), (MAX_TOPICS, 3));
    }

    #[test]
    fn memory_is_bounded() {
        let start = Instant::now();
        let mut counter = Counter::new(start);
        for n in 0..2 * MAX_TOPICS {
            counter.on_message(start + MS, &format!("t{n}"), 1, &"e".repeat(1000), None);
        }
        counter.on_message(start + MS, &"x".repeat(MAX_TOPIC_BYTES + 1), 1, "", None);
        for second in 0..1000 {
            counter.on_message(
                start + 1000 * second * MS,
                "t0",
                1,
                &"\u{e4}".repeat(1000),
                None,
            );
        }
        let report = counter.report(start + 2 * MS, None);
        assert_eq!(report.topics.len(), MAX_TOPICS);
        assert_eq!(report.more, MAX_TOPICS + 1);
        assert!(counter
            .topics
            .values()
            .all(|one| one.buckets.len() <= BUCKETS as usize + 1));
        assert!(counter
            .topics
            .values()
            .all(|one| one.encoding.len() <= MAX_ENCODING_BYTES));
    }

    #[test]
    fn an_answer_about_ten_topics_is_short_and_round_trips() {
        let start = Instant::now();
        let mut counter = Counter::new(start);
        for n in 0..10 {
            counter.on_message(
                start + MS,
                &format!("sensor/{n}"),
                24,
                "application/json",
                None,
            );
        }
        let report = counter.report(start + 2000 * MS, None);
        let json = serde_json::to_string(&report).expect("JSON");
        assert!(json.len() < 500, "{} bytes: {json}", json.len());
        let back = |report: &Topics| {
            let json = serde_json::to_string(report).expect("JSON");
            serde_json::from_str::<Topics>(&json).expect("valid JSON")
        };
        assert_eq!(back(&report), report);
        counter.on_message(start + 1000 * MS, "sensor/1", 24, "application/json", None);
        let one = counter.report(start + 2000 * MS, Some("sensor/1"));
        assert!(one.topics[0].interval_ms.is_some());
        assert_eq!(back(&one), one);
    }
}
