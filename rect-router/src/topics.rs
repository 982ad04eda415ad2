//! Answers which topics the robot's programs publish, and how often: `<fleet>/<robot>/@rect/topics` (docs/registry.md).
//!
//! Which topics there are is taken from the publishers that are declared at this router. Messages are counted by a
//! subscription to the robot's own keys, which are published at this router, so that nothing is pulled over the air. It
//! lives only while somebody asks.
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

/// Messages are counted for so long after the last question that asked for it.
const LEASE: Duration = Duration::from_secs(5);
/// How many questions may wait for the one before them.
const WAITING: usize = 16;
/// How long this router's own admin space has to answer.
const ADMIN_TIMEOUT: Duration = Duration::from_secs(1);

/// Answers until the session is closed. `own` is the beginning of the robot's own keys, `<fleet>/<robot>`; `host` the session
/// of a router in the same process at which the robot's programs are.
pub fn serve(session: &Session, host: Option<&Session>, own: &str) -> zenoh::Result<()> {
    let key = format!("{own}/@rect/{TOPICS}");
    let (queries, next) = mpsc::sync_channel(WAITING);
    let answering = Answering {
        session: session.clone(),
        admin: host.unwrap_or(session).clone(),
        own: own.to_owned(),
        key: key.clone(),
        measuring: None,
    };
    // It asks the admin space, and must not do that on a thread of Zenoh's.
    thread::Builder::new()
        .name("topics".to_owned())
        .spawn(move || answering.run(&next))?;
    let on_query = move |query: Query| {
        if let Err(TrySendError::Full(query)) = queries.try_send(query) {
            let busy = "too many ask about topics at once; try again";
            log(query.reply_err(busy).encoding(Encoding::TEXT_PLAIN).wait());
        }
    };
    let queryable = session.declare_queryable(key).callback(on_query);
    queryable.background().wait()
}

struct Answering {
    session: Session,
    admin: Session,
    own: String,
    key: String,
    measuring: Option<Measuring>,
}

struct Measuring {
    counter: Arc<Mutex<Counter>>,
    until: Instant,
    _subscriber: Subscriber<()>,
}

impl Answering {
    fn run(mut self, queries: &Receiver<Query>) {
        loop {
            let query = match &self.measuring {
                None => queries.recv().map_err(|_| RecvTimeoutError::Disconnected),
                Some(measuring) => {
                    queries.recv_timeout(measuring.until.saturating_duration_since(Instant::now()))
                }
            };
            match query {
                Ok(query) => self.answer(&query),
                Err(RecvTimeoutError::Timeout) => self.measuring = None,
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn answer(&mut self, query: &Query) {
        let made = Question::parse(query).and_then(|question| {
            if question.measure {
                self.measure().map_err(|error| error.to_string())?;
            }
            serde_json::to_vec(&self.topics(question.topic.as_deref()))
                .map_err(|error| error.to_string())
        });
        log(match made {
            Ok(json) => query
                .reply(&self.key, json)
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
            Err(wrong) => query.reply_err(wrong).encoding(Encoding::TEXT_PLAIN).wait(),
        });
    }

    fn topics(&self, topic: Option<&str>) -> Topics {
        let publishers = self.publishers();
        match &self.measuring {
            Some(measuring) => measuring
                .counter
                .lock()
                .report(Instant::now(), &publishers, topic),
            None => report_declared(&publishers, topic),
        }
    }

    /// Counts messages from now on, or for longer.
    fn measure(&mut self) -> zenoh::Result<()> {
        let now = Instant::now();
        if let Some(measuring) = &mut self.measuring {
            measuring.until = now + LEASE;
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
        self.measuring = Some(Measuring {
            counter,
            until: now + LEASE,
            _subscriber: subscriber,
        });
        Ok(())
    }

    /// How many publishers of each topic are declared at this router.
    fn publishers(&self) -> BTreeMap<String, usize> {
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
            // A publisher of several keys has no single topic.
            if !topic.contains('*') {
                let sources =
                    serde_json::from_slice(&sample.payload().to_bytes()).unwrap_or_default();
                publishers.insert(topic.to_owned(), count(&sources));
            }
        }
        publishers
    }
}

/// How many programs the admin space names as sources.
fn count(sources: &serde_json::Value) -> usize {
    let of = |kind: &str| sources[kind].as_array().map_or(0, Vec::len);
    (of("clients") + of("peers")).max(1)
}

fn log(replied: zenoh::Result<()>) {
    if let Err(error) = replied {
        tracing::debug!("no answer about topics could be sent: {error}");
    }
}

/// The parameters of a query.
#[derive(Debug, Default, PartialEq, Eq)]
struct Question {
    measure: bool,
    topic: Option<String>,
}

impl Question {
    fn parse(query: &Query) -> Result<Self, String> {
        Self::of(query.parameters().iter())
    }

    fn of<'a>(parameters: impl Iterator<Item = (&'a str, &'a str)>) -> Result<Self, String> {
        let mut question = Self::default();
        for (key, value) in parameters {
            match key {
                MEASURE => question.measure = true,
                TOPIC if !value.is_empty() => question.topic = Some(value.to_owned()),
                TOPIC => return Err(format!("{TOPIC} has no value: write {TOPIC}=arm/angle")),
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
    fn parameters_are_read_or_named() {
        let of =
            |parameters: &[(&'static str, &'static str)]| Question::of(parameters.iter().copied());
        let question = of(&[("measure", ""), ("topic", "arm/angle"), ("_time", "x")]);
        let expected = Question {
            measure: true,
            topic: Some("arm/angle".to_owned()),
        };
        assert_eq!(question, Ok(expected));
        assert_eq!(of(&[]), Ok(Question::default()));
        assert!(of(&[("topics", "1")]).is_err_and(|error| error.contains("`topics`")));
        assert!(of(&[("topic", "")]).is_err());
    }
}
