//! Decides what a recorder answers to a query for its recording.
use std::{fmt, ops::Bound, time::Duration};

use bytes::Bytes;
use rect_core::{
    message::{encoding::Encoding, payload::Payload, request::error_to_payload},
    name::{key::KeySpace, Name},
};
use zenoh_keyexpr::OwnedKeyExpr;

use crate::{
    excerpt::{Excerpt, Question},
    recorder::Recorder,
    time_range::TimeRange,
};

/// The part of RECT's internal keys under which a recorder answers. The key expression behind it selects `<robot>/<topic>`.
const RECORDING: &str = "recording";
/// Selects all messages.
const ALL: &str = "**";
/// The parameter for the time, of which Zenoh defines the notation.
const TIME: &str = "_time";
/// The parameter for an answer in one file.
pub const FORM: &str = "form";
/// The form of that file.
pub const MCAP: &str = "mcap";
/// The number of queries that wait at most. Further ones are refused.
pub const WAITING: usize = 8;
/// The size of the messages in one answer, in bytes, so that it takes about a second over Bluetooth.
const PAGE_BYTES: usize = 64 * 1024;
/// The largest number of messages that are sent one by one.
const MAX_MESSAGES: usize = 1000;

/// The answer of a recorder to a query: replies, and then an error if there is one.
#[derive(Debug, Default)]
pub struct Answer {
    /// The messages, or one file with them.
    pub replies: Vec<Reply>,
    /// Why there are no messages, or not all of them.
    pub error: Option<Payload>,
}

/// A reply to a query.
#[derive(Debug)]
pub struct Reply {
    /// The key.
    pub key: String,
    /// The message, or the file.
    pub payload: Payload,
    /// When the message was recorded, since 1970; `None` for a file.
    pub recorded: Option<Duration>,
}

/// Returns the key under which the recorder of `robot` answers.
pub fn key(place: &KeySpace, robot: &Name) -> String {
    place.own(Some(robot), RECORDING)
}

/// Returns the answer to a query that finds too many others waiting.
pub fn busy(place: &KeySpace) -> Payload {
    let problem = "too many questions about the recording at once: try again";
    refusal(&place.robot, problem)
}

fn refusal(robot: &Name, problem: &str) -> Payload {
    error_to_payload(robot, Payload::new(problem.to_owned(), Encoding::TEXT))
}

impl Answer {
    /// Returns the answer of a recorder at `place` to a query for the key expression `asked` with `parameters`. Reads files.
    pub fn to(asked: &str, parameters: &str, recorder: &Recorder, place: &KeySpace) -> Self {
        let mut answer = Self::default();
        if let Err(problem) = answer.fill(asked, parameters, recorder, place) {
            answer.error = Some(refusal(&place.robot, &problem));
        }
        answer
    }

    fn fill(
        &mut self,
        asked: &str,
        parameters: &str,
        recorder: &Recorder,
        place: &KeySpace,
    ) -> Result<(), String> {
        let (question, is_file) = question(asked, parameters, recorder.now())?;
        let max_count = if is_file { usize::MAX } else { MAX_MESSAGES };
        let excerpt = Excerpt::read(&recorder.readable(), &question, PAGE_BYTES, max_count);
        let excerpt = excerpt.map_err(text)?;
        let own = key(place, &place.robot);
        if is_file {
            let file = excerpt.encode(recorder.about().clone(), question.until);
            let file = Bytes::from(file.map_err(text)?);
            self.replies.push(Reply {
                key: own,
                payload: Payload::new(file, Encoding::new("application/mcap")),
                recorded: None,
            });
            return Ok(());
        }
        self.replies = Vec::from_iter(excerpt.entries.into_iter().map(|entry| Reply {
            key: format!("{own}/{}", entry.topic),
            payload: entry.payload,
            recorded: Some(entry.logged),
        }));
        match excerpt.more {
            false => Ok(()),
            true => Err(format!(
                "more messages follow: at most {MAX_MESSAGES} or {PAGE_BYTES} bytes are sent at once; ask for a shorter time, or \
                 use `rect recording fetch {}`",
                place.robot
            )),
        }
    }
}

/// Returns the selected messages, and whether they are to be sent as a file.
fn question(asked: &str, parameters: &str, now: Duration) -> Result<(Question, bool), String> {
    // The robot may be a wildcard; the parts before the internal ones contain no others.
    let topics = asked.split_once(&format!("@rect/{RECORDING}"));
    let topics = topics.map_or("", |(_, topics)| topics.trim_start_matches('/'));
    let topics = if topics.is_empty() { ALL } else { topics };
    let mut is_file = false;
    let mut time = None;
    for parameter in parameters.split(';') {
        match parameter.split_once('=').unwrap_or((parameter, "")) {
            (FORM, MCAP) => is_file = true,
            (FORM, _) => return Err(format!("{FORM} is {MCAP}, or is left out")),
            (TIME, range) => time = Some(range),
            // Zenoh's own.
            (name, _) if name.is_empty() || name.starts_with('_') => {}
            (name, _) => return Err(format!("`{name}` is unknown; known are {TIME} and {FORM}")),
        }
    }
    let time = time.ok_or("name the time, such as _time=[now(-10s)..]")?;
    let range = TimeRange::parse(time, now).map_err(|error| format!("the time {time}: {error}"))?;
    let step = Duration::from_nanos(1);
    let begin = match range.start {
        Bound::Included(time) => time,
        Bound::Excluded(time) => time + step,
        Bound::Unbounded => Duration::ZERO,
    };
    // A question that continues after a message has them already.
    let retained = is_file && !matches!(range.start, Bound::Excluded(_));
    let until = match range.end {
        Bound::Included(time) => time,
        Bound::Excluded(time) => time.saturating_sub(step),
        Bound::Unbounded => now,
    };
    let question = Question {
        topics: OwnedKeyExpr::new(topics).map_err(text)?,
        // They have keys of RECT's own, which a stock program has not asked for.
        reports: is_file && topics == ALL,
        begin,
        until,
        retained,
    };
    Ok((question, is_file))
}

fn text(error: impl fmt::Display) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Duration = Duration::from_secs(1_000_000_000);

    fn asked(selector: &str) -> Result<(Question, bool), String> {
        let (key, parameters) = selector.split_once('?').unwrap_or((selector, ""));
        question(key, parameters, NOW)
    }

    #[test]
    fn time_is_relative_to_the_clock_of_the_recorder() {
        let (question, is_file) =
            asked("rect/a/@rect/recording/a/*?_time=[now(-10s)..now(-4s)]").expect("a question");
        assert!(!is_file);
        assert_eq!(question.topics.as_str(), "a/*");
        assert_eq!(question.begin, NOW - Duration::from_secs(10));
        assert_eq!(question.until, NOW - Duration::from_secs(4));
    }

    #[test]
    fn file_of_everything_has_the_reports() {
        for (selector, reports) in [
            ("rect/*/@rect/recording?form=mcap;_time=[now(-10s)..]", true),
            (
                "rect/a/@rect/recording/**?form=mcap;_time=[now(-10s)..]",
                true,
            ),
            (
                "rect/a/@rect/recording/a/n?form=mcap;_time=[now(-10s)..]",
                false,
            ),
        ] {
            let (question, is_file) = asked(selector).expect("a question");
            assert!(is_file);
            assert_eq!(question.reports, reports, "{selector}");
        }
    }

    #[test]
    fn bounds_may_be_left_out_and_exclusive() {
        let (question, _) = asked("rect/a/@rect/recording/**?_time=[..]").expect("a question");
        assert_eq!((question.begin, question.until), (Duration::ZERO, NOW));
        let (question, _) =
            asked("rect/a/@rect/recording/**?_time=]now()..now()[").expect("a question");
        let step = Duration::from_nanos(1);
        assert_eq!((question.begin, question.until), (NOW + step, NOW - step));
    }
}
