//! Answers queries about the topics that the robot's programs publish and their rates: `<fleet>/<robot>/@rect/topics`
//! (docs/reference/registry.md).
//!
//! The topics are those of the publishers declared at this router. Messages are counted by a subscription to the robot's own
//! keys; they are published at this router, so that the subscription causes no traffic over the air. It exists only
//! while rates are queried.
use std::{
    collections::BTreeMap,
    sync::{
        mpsc::{self, Receiver, RecvTimeoutError, TrySendError},
        Arc,
    },
    thread,
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use rect::core::topics::{report_declared, Counter, Topics, MEASURE, TOPIC, TOPICS};
use zenoh::{bytes::Encoding, pubsub::Subscriber, query::Query, sample::Sample, Session, Wait};

/// Time for which messages are counted after the last query that requested it.
const LEASE: Duration = Duration::from_secs(5);
/// Maximum number of queries that wait for the one in progress; further queries are answered with an error.
const MAX_WAITING_QUERIES: usize = 16;
/// How long the service waits for the declarations that arrive together with a query.
const DECLARATIONS_PASS: Duration = Duration::from_millis(50);
/// Timeout of the query to this router's own admin space.
const ADMIN_TIMEOUT: Duration = Duration::from_secs(1);

/// Declares the queryable, which answers until the session is closed. `own` is the prefix of the robot's keys,
/// `<fleet>/<robot>`. `host` is the session of another router in this process to which the robot's programs are connected.
///
/// # Errors
/// Fails if the queryable cannot be declared or the thread cannot be started.
pub fn serve(session: &Session, host: Option<&Session>, own: &str) -> zenoh::Result<()> {
    let key = format!("{own}/@rect/{TOPICS}");
    let (queries, next) = mpsc::sync_channel(MAX_WAITING_QUERIES);
    let service = TopicService {
        session: session.clone(),
        admin: host.unwrap_or(session).clone(),
        own: own.to_owned(),
        key: key.clone(),
        measurement: None,
    };
    // The service queries the admin space, which must not happen on one of Zenoh's threads.
    thread::Builder::new()
        .name("topics".to_owned())
        .spawn(move || service.run(&next))?;
    let on_query = move |query: Query| {
        if let Err(TrySendError::Full(query)) = queries.try_send(query) {
            let busy = "too many queries about topics are waiting; try again";
            log_failure(query.reply_err(busy).encoding(Encoding::TEXT_PLAIN).wait());
        }
    };
    let queryable = session.declare_queryable(key).callback(on_query);
    queryable.background().wait()
}

/// Answers the queries, on a thread of its own.
struct TopicService {
    session: Session,
    admin: Session,
    own: String,
    key: String,
    measurement: Option<Measurement>,
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
            if question.measure {
                self.measure().map_err(|error| error.to_string())?;
            }
            serde_json::to_vec(&self.topics(question.topic.as_deref()))
                .map_err(|error| error.to_string())
        });
        log_failure(match made {
            Ok(json) => query
                .reply(&self.key, json)
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
            Err(error) => query.reply_err(error).encoding(Encoding::TEXT_PLAIN).wait(),
        });
    }

    fn topics(&self, topic: Option<&str>) -> Topics {
        let publishers = self.publishers();
        match &self.measurement {
            Some(measurement) => {
                measurement
                    .counter
                    .lock()
                    .report(Instant::now(), &publishers, topic)
            }
            None => report_declared(&publishers, topic),
        }
    }

    /// Starts counting messages, or prolongs the counting.
    fn measure(&mut self) -> zenoh::Result<()> {
        let now = Instant::now();
        if let Some(measurement) = &mut self.measurement {
            measurement.until = now + LEASE;
            return Ok(());
        }
        let counter = Arc::new(Mutex::new(Counter::new(now)));
        let (counting, prefix) = (Arc::clone(&counter), format!("{}/", self.own));
        let on_sample = move |sample: Sample| {
            let Some(topic) = sample.key_expr().as_str().strip_prefix(&prefix) else {
                return;
            };
            let (bytes, encoding) = (sample.payload().len(), sample.encoding().to_string());
            counting
                .lock()
                .on_message(Instant::now(), topic, bytes, &encoding);
        };
        let subscriber = self.session.declare_subscriber(format!("{}/**", self.own));
        let subscriber = subscriber.callback(on_sample).wait()?;
        self.measurement = Some(Measurement {
            counter,
            until: now + LEASE,
            _subscriber: subscriber,
        });
        Ok(())
    }

    /// Returns the number of publishers of each topic that are declared at this router.
    ///
    /// Zenoh 1.10's admin space replies while it holds its routing tables for reading, and reads them again for the reply. If
    /// a declaration arrives in between, the router stops for good (`resources_data` in `net/runtime/adminspace.rs`). A
    /// query often arrives together with declarations of the same session; the delay lets these pass first.
    fn publishers(&self) -> BTreeMap<String, usize> {
        thread::sleep(DECLARATIONS_PASS);
        let admin = format!("@/{}/router/publisher/", self.admin.zid());
        let prefix = format!("{admin}{}/", self.own);
        let asked = self
            .admin
            .get(format!("{prefix}**"))
            .timeout(ADMIN_TIMEOUT)
            .wait();
        let mut publishers = BTreeMap::new();
        for reply in asked.into_iter().flatten() {
            let Ok(sample) = reply.into_result() else {
                continue;
            };
            let Some(topic) = sample.key_expr().as_str().strip_prefix(&prefix) else {
                continue;
            };
            // A publisher of a key expression with wildcards has no single topic.
            if !topic.contains('*') {
                let sources =
                    serde_json::from_slice(&sample.payload().to_bytes()).unwrap_or_default();
                publishers.insert(topic.to_owned(), count(&sources));
            }
        }
        publishers
    }
}

/// Returns the number of programs that the admin space names as sources, at least 1.
fn count(sources: &serde_json::Value) -> usize {
    let of = |kind: &str| sources[kind].as_array().map_or(0, Vec::len);
    (of("clients") + of("peers")).max(1)
}

fn log_failure(replied: zenoh::Result<()>) {
    if let Err(error) = replied {
        tracing::debug!("cannot send a reply about topics: {error}");
    }
}

/// The parameters of a query.
#[derive(Debug, Default, PartialEq, Eq)]
struct TopicQuery {
    measure: bool,
    topic: Option<String>,
}

impl TopicQuery {
    fn parse(query: &Query) -> Result<Self, String> {
        Self::of(query.parameters().iter())
    }

    fn of<'a>(parameters: impl Iterator<Item = (&'a str, &'a str)>) -> Result<Self, String> {
        let mut question = Self::default();
        for (key, value) in parameters {
            match key {
                MEASURE => question.measure = true,
                TOPIC if !value.is_empty() => question.topic = Some(value.to_owned()),
                TOPIC => {
                    return Err(format!(
                        "{TOPIC} has no value; write for example {TOPIC}=arm/angle"
                    ))
                }
                _ if key.is_empty() || key.starts_with('_') => {}
                _ => {
                    return Err(format!(
                        "`{key}` is unknown; known are {MEASURE} and {TOPIC}"
                    ))
                }
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
        let question = of(&[("measure", ""), ("topic", "arm/angle"), ("_time", "x")]);
        let expected = TopicQuery {
            measure: true,
            topic: Some("arm/angle".to_owned()),
        };
        assert_eq!(question, Ok(expected));
        assert_eq!(of(&[]), Ok(TopicQuery::default()));
        assert!(of(&[("topics", "1")]).is_err_and(|error| error.contains("`topics`")));
        assert!(of(&[("topic", "")]).is_err());
    }
}
