//! Shows a recorded robot to the programs at the router of a replay, as its own router would: that it is reachable, and its topics.
use std::{
    sync::{Arc, Mutex, PoisonError},
    time::Instant,
};

use rect::{Payload, Robot};
use rect_core::registry::topics::{Counter, TOPIC, TOPICS};
use zenoh::{bytes::Encoding, liveliness::LivelinessToken, query::Query, Wait};

/// A robot that is shown, until this is dropped.
pub struct Presence {
    counter: Arc<Mutex<Counter>>,
    _token: LivelinessToken,
}

impl Presence {
    /// Begins to show a robot.
    ///
    /// # Errors
    /// Fails if Zenoh refuses it.
    pub fn start(robot: &Robot) -> zenoh::Result<Self> {
        let session = robot.zenoh();
        let own = format!("{}/{}/@rect", robot.fleet(), robot.name());
        let counter = Arc::new(Mutex::new(Counter::new(Instant::now())));
        let (counted, key) = (Arc::clone(&counter), format!("{own}/{TOPICS}"));
        let answered = key.clone();
        let on_query = move |query: Query| {
            let topic = query.parameters().get(TOPIC).map(str::to_owned);
            let counter = counted.lock().unwrap_or_else(PoisonError::into_inner);
            let topics = counter.report(Instant::now(), topic.as_deref());
            drop(counter);
            let json = serde_json::to_vec(&topics).unwrap_or_default();
            // It fails if the program that asks has ended.
            let _ = query
                .reply(&answered, json)
                .encoding(Encoding::APPLICATION_JSON)
                .wait();
        };
        let queryable = session.declare_queryable(key).callback(on_query);
        queryable.background().wait()?;
        let token = format!("{own}/alive/{}", session.zid());
        Ok(Self {
            counter,
            _token: session.liveliness().declare_token(token).wait()?,
        })
    }

    /// Counts a message of the robot.
    pub fn on_message(&self, topic: &str, payload: &Payload) {
        let mut counter = self.counter.lock().unwrap_or_else(PoisonError::into_inner);
        let (size, encoding) = (payload.bytes.len(), payload.encoding.as_str());
        counter.on_message(Instant::now(), topic, size, encoding, None);
    }
}
