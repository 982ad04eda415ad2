//! Answers queries about the topics that the robot's programs publish or have retained, and their rates:
//! `<fleet>/<robot>/@rect/topics` (docs/reference/registry.md).
//!
//! A query makes the router count messages, by a subscription to the robot's own keys. They are published at this router, so
//! that the subscription causes no traffic over the air. It ends a few seconds after the last query.
//!
//! The robot's slow links count what they send for each topic from the same questions on (`usage`).
//!
//! Zenoh's admin space would list declared publishers without a subscription. It is not used, because such a query can stop a
//! router of Zenoh 1.10 for good (`tests/upstream/admin_space_freeze.py`).
mod usage;

use std::{
    sync::{
        mpsc::{Receiver, RecvTimeoutError},
        Arc,
    },
    thread,
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use rect_core::{
    message::attachment::Attachment,
    registry::topics::{Counter, RetainedTopic, Topics, KEEP, KEPT, MAX_KEPT, TOPIC, TOPICS},
};
use zenoh::{
    pubsub::Subscriber,
    query::Query,
    sample::{Sample, SampleKind},
    Session, Wait,
};

use crate::reply;

/// Maximum number of queries that wait for the one in progress; further queries are answered with an error.
const MAX_WAITING_QUERIES: usize = 16;

/// Returns the topics that the router retains.
pub type RetainedTopics = Box<dyn Fn() -> Vec<RetainedTopic> + Send>;

/// Declares the queryable, which answers until the session is closed. `own` is the prefix of the robot's keys,
/// `<fleet>/<robot>`. `retained` returns the topics that are listed even if no message is counted.
///
/// # Errors
/// Fails if the queryable cannot be declared or the thread cannot be started.
pub fn serve(session: &Session, own: &str, retained: RetainedTopics) -> zenoh::Result<()> {
    let key = format!("{own}/@rect/{TOPICS}");
    let busy = "too many queries about topics are waiting; try again";
    let next = reply::queue(session, &key, MAX_WAITING_QUERIES, busy)?;
    let service = TopicService {
        session: session.clone(),
        own: own.to_owned(),
        key,
        measurement: None,
        retained,
    };
    // A thread of its own ends the count when no more queries arrive.
    thread::Builder::new()
        .name("topics".to_owned())
        .spawn(move || service.run(&next))?;
    Ok(())
}

/// Answers the queries, on a thread of its own.
struct TopicService {
    session: Session,
    own: String,
    key: String,
    measurement: Option<Measurement>,
    retained: RetainedTopics,
}

/// A running count of messages, until a point in time that each query postpones.
struct Measurement {
    counter: Arc<Mutex<Counter>>,
    until: Instant,
    _subscriber: Subscriber<()>,
}

impl TopicService {
    fn run(mut self, queries: &Receiver<Query>) {
        loop {
            let query = match &self.measurement {
                None => queries.recv().map_err(|_| RecvTimeoutError::Disconnected),
                Some(measurement) => queries
                    .recv_timeout(measurement.until.saturating_duration_since(Instant::now())),
            };
            match query {
                Ok(query) => self.answer(&query),
                Err(RecvTimeoutError::Timeout) => self.measurement = None,
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn answer(&mut self, query: &Query) {
        let made = TopicQuery::parse(query).and_then(|question| {
            let topics = self.count(&question);
            topics.map_err(|error| error.to_string())
        });
        reply::reply(query, &self.key, made);
    }

    /// Starts counting messages, or prolongs the count, and returns what was counted until now.
    fn count(&mut self, question: &TopicQuery) -> zenoh::Result<Topics> {
        let now = Instant::now();
        let measurement = match self.measurement.take() {
            Some(measurement) => measurement,
            None => self.start(now)?,
        };
        let measurement = self.measurement.insert(Measurement {
            until: measurement.until.max(now + question.keep),
            ..measurement
        });
        let topic = question.topic.as_deref();
        let counted = measurement.counter.lock().report(now, topic);
        let topics = counted.with_retained((self.retained)(), topic);
        let (fleet, robot) = self.own.split_once('/').unwrap_or_default();
        let of_robot = topic.map(|topic| format!("{robot}/{topic}"));
        Ok(Topics {
            links: usage::usage(fleet, question.keep, of_robot.as_deref()),
            ..topics
        })
    }

    fn start(&self, now: Instant) -> zenoh::Result<Measurement> {
        let counter = Arc::new(Mutex::new(Counter::new(now)));
        let (counting, prefix) = (Arc::clone(&counter), format!("{}/", self.own));
        let on_sample = move |sample: Sample| {
            let Some(topic) = sample.key_expr().as_str().strip_prefix(&prefix) else {
                return;
            };
            // A topic that is forgotten is not published on.
            if sample.kind() == SampleKind::Delete {
                return;
            }
            let (bytes, encoding) = (sample.payload().len(), sample.encoding().to_string());
            let attachment = sample
                .attachment()
                .and_then(|bytes| Attachment::decode(&bytes.to_bytes()));
            let numbers = attachment.map(|attachment| (attachment.source, attachment.sequence));
            counting
                .lock()
                .on_message(Instant::now(), topic, bytes, &encoding, numbers);
        };
        let subscriber = self.session.declare_subscriber(format!("{}/**", self.own));
        let subscriber = subscriber.callback(on_sample).wait()?;
        Ok(Measurement {
            counter,
            until: now,
            _subscriber: subscriber,
        })
    }
}

/// The parameters of a query.
#[derive(Debug, PartialEq, Eq)]
struct TopicQuery {
    topic: Option<String>,
    /// For how long to count after it.
    keep: Duration,
}

impl Default for TopicQuery {
    fn default() -> Self {
        Self {
            topic: None,
            keep: KEPT,
        }
    }
}

impl TopicQuery {
    fn parse(query: &Query) -> Result<Self, String> {
        Self::of(query.parameters().iter())
    }

    fn of<'a>(parameters: impl Iterator<Item = (&'a str, &'a str)>) -> Result<Self, String> {
        let mut question = Self::default();
        for (key, value) in parameters {
            match key {
                TOPIC if !value.is_empty() => question.topic = Some(value.to_owned()),
                TOPIC => {
                    return Err(format!(
                        "{TOPIC} has no value; write for example {TOPIC}=arm/angle"
                    ))
                }
                KEEP => {
                    let seconds = value.parse().map(Duration::from_secs);
                    let range = KEPT..=MAX_KEPT;
                    let keep = seconds.ok().filter(|keep| range.contains(keep));
                    question.keep = keep.ok_or_else(|| {
                        format!("{KEEP} is a number of seconds, 5 to 30: {KEEP}=15")
                    })?;
                }
                _ if key.is_empty() || key.starts_with('_') => {}
                _ => return Err(format!("`{key}` is unknown; known are {TOPIC} and {KEEP}")),
            }
        }
        Ok(question)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_parameters_and_names_invalid_ones() {
        let of = |parameters: &[(&'static str, &'static str)]| {
            TopicQuery::of(parameters.iter().copied())
        };
        let question = of(&[("topic", "arm/angle"), ("_time", "x"), ("keep_s", "15")]);
        let expected = TopicQuery {
            topic: Some("arm/angle".to_owned()),
            keep: Duration::from_secs(15),
        };
        assert_eq!(question, Ok(expected));
        assert_eq!(of(&[]), Ok(TopicQuery::default()));
        assert!(of(&[("topics", "1")]).is_err_and(|error| error.contains("`topics`")));
        for invalid in [
            ("topic", ""),
            ("keep_s", "4"),
            ("keep_s", "31"),
            ("keep_s", "x"),
        ] {
            assert!(of(&[invalid]).is_err(), "{invalid:?}");
        }
    }
}
