//! Reads a part of a recording that runs, for those who ask its recorder.
use std::{
    io::{self, Cursor},
    path::{Path, PathBuf},
    time::Duration,
};

use zenoh_keyexpr::{keyexpr, OwnedKeyExpr};

use crate::{
    entry::Entry,
    entry::RetainedKind,
    file::{About, Encoder},
    log,
    reader::{end_of, files_of, ReadError, Reader},
    retained::LastValues,
};

/// The name of the description that tells the end of the requested time, in nanoseconds since 1970.
pub const UNTIL: &str = "excerpt_until_ns";
/// The name of the description that tells whether more messages follow in that time.
pub const MORE: &str = "excerpt_more";
/// How often reading begins again, because a file was completed or removed meanwhile.
const ATTEMPTS: usize = 3;

/// Selects messages of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Question {
    /// Matches `<robot>/<topic>`.
    pub topics: OwnedKeyExpr,
    /// Whether all events and links are selected, too.
    pub reports: bool,
    /// The first time, since 1970.
    pub begin: Duration,
    /// The last time.
    pub until: Duration,
    /// Whether the values that were retained before the first time are selected, too.
    pub retained: bool,
}

/// Messages of a recording, in the order of recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Excerpt {
    /// The messages.
    pub entries: Vec<Entry>,
    /// Whether more of the selected messages follow.
    pub more: bool,
}

impl Question {
    /// Returns whether a message is selected. The lines that programs log never are: access to them has a rule of its own.
    fn selects(&self, entry: &Entry) -> bool {
        if log::is_log(&entry.topic) {
            return false;
        }
        let is_in_time = self.begin <= entry.logged && entry.logged <= self.until;
        is_in_time && (self.matches(&entry.topic) || (self.reports && entry.is_report()))
    }

    fn matches(&self, topic: &str) -> bool {
        keyexpr::new(topic).is_ok_and(|topic| self.topics.intersects(topic))
    }
}

impl Excerpt {
    /// Reads the selected messages from the files and folders `paths`. It ends where the messages have more than `max_bytes`, or
    /// `max_count` messages are read, but contains at least one message, and all that were recorded at the same time.
    ///
    /// # Errors
    /// Fails if a file cannot be read.
    pub fn read(
        paths: &[PathBuf],
        question: &Question,
        max_bytes: usize,
        max_count: usize,
    ) -> Result<Self, ReadError> {
        let mut attempt = 1;
        loop {
            match Self::read_once(paths, question, max_bytes, max_count) {
                Err(ReadError::Io { source, .. })
                    if source.kind() == io::ErrorKind::NotFound && attempt < ATTEMPTS =>
                {
                    attempt += 1;
                }
                read => return read,
            }
        }
    }

    fn read_once(
        paths: &[PathBuf],
        question: &Question,
        max_bytes: usize,
        max_count: usize,
    ) -> Result<Self, ReadError> {
        let mut files = Vec::new();
        for path in paths {
            match files_of(path) {
                Ok(found) => files.extend(found),
                // Nothing has been recorded in it yet.
                Err(ReadError::Empty(_)) => {}
                Err(error) => return Err(error),
            }
        }
        let is_earlier = |file: &PathBuf| end_of(file).is_some_and(|end| end < question.begin);
        // Later files need not be looked into: the files are in the order of their times.
        if let Some(last_earlier) = files.iter().rposition(is_earlier) {
            files.drain(..=last_earlier);
        }
        let mut excerpt = Self::default();
        let mut bytes = 0;
        let mut values = LastValues::default();
        let mut started = None;
        for entry in Reader::of_files(files) {
            let entry = entry?;
            let begin = *started.get_or_insert(entry.logged.max(question.begin));
            // The files between two excerpts repeat values, which belong to none of them.
            let is_repeated = entry.retained == Some(RetainedKind::Repeated);
            let is_before = entry.logged < begin || is_repeated;
            if is_before && excerpt.entries.is_empty() && question.matches(&entry.topic) {
                values.on_entry(entry);
                continue;
            }
            if entry.logged > question.until {
                break;
            }
            if is_repeated || !question.selects(&entry) {
                continue;
            }
            let is_full = bytes > max_bytes || excerpt.entries.len() >= max_count;
            let last = excerpt.entries.last();
            if is_full && last.is_some_and(|last: &Entry| last.logged < entry.logged) {
                excerpt.more = true;
                break;
            }
            bytes += entry.bytes();
            excerpt.entries.push(entry);
        }
        if let Some(begin) = started.filter(|_| question.retained) {
            (excerpt.entries).splice(..0, values.repeated(begin));
        }
        Ok(excerpt)
    }

    /// Returns the excerpt as an MCAP file, whose description tells how to continue.
    ///
    /// # Errors
    /// Fails if there are too many topics.
    pub fn encode(&self, mut about: About, until: Duration) -> io::Result<Vec<u8>> {
        about.insert(UNTIL.to_owned(), until.as_nanos().to_string());
        about.insert(MORE.to_owned(), self.more.to_string());
        let mut encoder = Encoder::new(Cursor::new(Vec::new()), &about)?;
        for entry in &self.entries {
            encoder.add(entry)?;
        }
        Ok(encoder.finish()?.into_inner())
    }

    /// Reads an encoded excerpt. Returns it with the description of the recording, and the end of the requested time.
    ///
    /// # Errors
    /// Fails if it is damaged.
    pub fn decode(bytes: Vec<u8>) -> Result<(Self, About, Duration), ReadError> {
        let mut reader = Reader::of(Path::new("the answer").to_owned(), Cursor::new(bytes))?;
        let entries = reader.by_ref().collect::<Result<Vec<_>, _>>()?;
        let mut about = reader.about().clone();
        let until_ns = about.remove(UNTIL).and_then(|ns| ns.parse().ok());
        let more = about.remove(MORE).is_some_and(|more| more == "true");
        let until = Duration::from_nanos(until_ns.unwrap_or(u64::MAX));
        Ok((Self { entries, more }, about, until))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segments::{folder_of, Segments};
    use rect_core::message::{encoding::Encoding, payload::Payload, urgency::Urgency};

    fn entry(topic: &str, ms: u64) -> Entry {
        Entry {
            topic: topic.to_owned(),
            recipient: None,
            payload: Payload::new(ms.to_string(), Encoding::JSON),
            urgency: Urgency::Normal,
            sequence: 0,
            publisher: None,
            logged: Duration::from_millis(ms),
            sent: Duration::from_millis(ms),
            retained: None,
            foreign: None,
        }
    }

    fn question(topics: &str, begin_ms: u64, until_ms: u64) -> Question {
        Question {
            topics: OwnedKeyExpr::new(topics).expect("key expression"),
            reports: false,
            begin: Duration::from_millis(begin_ms),
            until: Duration::from_millis(until_ms),
            retained: true,
        }
    }

    #[test]
    fn begins_with_the_values_that_were_retained_before() {
        use RetainedKind::{Forgotten, Repeated, Value};
        let folder = tempfile::tempdir().expect("folder");
        let folder = folder_of(&folder.path().join("match.mcap"));
        std::fs::create_dir_all(folder.parent().expect("a folder")).expect("created");
        let mut segments = Segments::create(folder.clone(), About::new(), None).expect("created");
        let retained = [
            (200, "a/mode", Value),
            (300, "a/map", Value),
            (9_000, "a/mode", Value),
        ];
        let retained = retained.into_iter().chain([(16_000, "a/map", Forgotten)]);
        let mut retained = retained.peekable();
        for ms in (0..20_000).step_by(100) {
            while let Some((_, topic, kind)) = retained.next_if(|(at, ..)| *at == ms) {
                let retained = Some(kind);
                let entry = Entry {
                    retained,
                    ..entry(topic, ms)
                };
                segments.write(entry).expect("written");
            }
            segments.write(entry("a/count", ms)).expect("written");
            segments
                .on_time(Duration::from_millis(ms))
                .expect("on time");
        }
        segments.flush().expect("flushed");
        std::mem::forget(segments);
        let paths = vec![folder];
        let read = |topics, begin, until, retained| {
            let question = Question {
                retained,
                ..question(topics, begin, until)
            };
            let read = Excerpt::read(&paths, &question, usize::MAX, usize::MAX).expect("read");
            let rows = read
                .entries
                .into_iter()
                .filter(|entry| entry.retained.is_some());
            let rows = rows.map(|entry| {
                let value = entry.payload.text().expect("text").to_owned();
                (
                    entry.logged.as_millis(),
                    entry.topic,
                    value,
                    entry.retained.expect("kept"),
                )
            });
            rows.collect::<Vec<_>>()
        };
        let row =
            |at, topic: &str, value: &str, kind| (at, topic.to_owned(), value.to_owned(), kind);
        let old = [
            row(7_050, "a/map", "300", Repeated),
            row(7_050, "a/mode", "200", Repeated),
        ];
        assert_eq!(read("**", 7_050, 8_000, true), old);
        assert_eq!(read("**", 7_050, 8_000, false), []);
        assert_eq!(read("a/mode", 7_050, 8_000, true), old[1..]);
        let new = row(9_000, "a/mode", "9000", Value);
        assert_eq!(read("**", 7_050, 9_500, true), [&old[..], &[new]].concat());
        let last = row(18_000, "a/mode", "9000", Repeated);
        assert_eq!(read("**", 18_000, 60_000, true), [last]);
        assert_eq!(read("**", 0, 250, true), [row(200, "a/mode", "200", Value)]);
    }

    /// Records a message every 100 ms for 20 s, in segments of 5 s, of which the last one is not complete.
    fn recorded(folder: &Path) -> Vec<PathBuf> {
        let folder = folder_of(&folder.join("match.mcap"));
        let mut segments = Segments::create(folder.clone(), About::new(), None).expect("created");
        for number in 0..200 {
            let entry = entry(&format!("wombat-{}/count", number % 2 + 1), number * 100);
            let logged = entry.logged;
            segments.write(entry).expect("written");
            segments.on_time(logged).expect("on time");
        }
        segments.flush().expect("flushed");
        // Its destructor would complete the file.
        std::mem::forget(segments);
        vec![folder]
    }

    #[test]
    fn reads_the_selected_time_and_topics_of_a_recording_that_runs() {
        let folder = tempfile::tempdir().expect("folder");
        let paths = recorded(folder.path());
        let read = |question| Excerpt::read(&paths, &question, usize::MAX, usize::MAX);
        let last = read(question("**", 18_950, 60_000)).expect("read");
        let times: Vec<_> = last.entries.iter().map(|e| e.logged.as_millis()).collect();
        assert_eq!(times, (190..200).map(|n| n * 100).collect::<Vec<_>>());
        let one = read(question("wombat-1/*", 4_000, 6_000)).expect("read");
        assert_eq!(one.entries.len(), 11);
        assert!(one
            .entries
            .iter()
            .all(|entry| entry.topic == "wombat-1/count"));
        assert!(read(question("wombat-3/**", 0, 60_000))
            .expect("read")
            .entries
            .is_empty());
    }

    #[test]
    fn pages_contain_each_message_once() {
        let folder = tempfile::tempdir().expect("folder");
        let paths = recorded(folder.path());
        let mut begin = Duration::ZERO;
        let mut times = Vec::new();
        loop {
            let asked = Question {
                begin,
                ..question("**", 0, 15_000)
            };
            let page = Excerpt::read(&paths, &asked, 1000, usize::MAX).expect("read");
            let bytes = page.encode(About::new(), asked.until).expect("encoded");
            let (decoded, _, until) = Excerpt::decode(bytes).expect("decoded");
            assert_eq!((&decoded, until), (&page, asked.until));
            times.extend(page.entries.iter().map(|entry| entry.logged.as_millis()));
            if !page.more {
                break;
            }
            begin = page.entries.last().expect("not empty").logged + Duration::from_nanos(1);
        }
        assert_eq!(times, (0..=150).map(|n| n * 100).collect::<Vec<_>>());
    }

    #[test]
    fn damaged_answers_are_rejected() {
        let page = Excerpt {
            entries: vec![entry("wombat-1/count", 5)],
            more: false,
        };
        let bytes = page.encode(About::new(), Duration::MAX).expect("encoded");
        for end in [0, 10, bytes.len() / 2] {
            assert!(Excerpt::decode(bytes[..end].to_vec()).is_err(), "{end}");
        }
    }
}
