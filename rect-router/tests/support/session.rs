//! Zenoh sessions with a router, and what is asked through them.
use std::time::{Duration, Instant};

use serde_json::{json, Value};
use zenoh::{query::Reply, Config, Session, Wait};

use super::DEADLINE;

/// For an answer that may not come.
const PATIENCE: Duration = Duration::from_secs(10);

/// A client of the router at `endpoint`, with further settings.
pub fn client_with(endpoint: &str, settings: &[(&str, &str)]) -> zenoh::Result<Session> {
    let mut config = Config::default();
    let endpoints = json!([endpoint]).to_string();
    let base = [
        ("mode", "\"client\""),
        ("connect/endpoints", endpoints.as_str()),
        ("scouting/multicast/enabled", "false"),
    ];
    for (key, value) in base.iter().chain(settings) {
        config.insert_json5(key, value)?;
    }
    zenoh::open(config).wait()
}

/// A client of the router at `endpoint`.
pub fn client(endpoint: &str) -> Session {
    client_with(endpoint, &[]).unwrap_or_else(|error| panic!("no session with {endpoint}: {error}"))
}

/// Publishes until it arrives: a subscription takes a moment to reach the publisher's side.
pub fn arrives(from: &Session, to: &Session, key: &str) -> bool {
    let subscriber = to.declare_subscriber(key).wait().expect("a subscription");
    let deadline = Instant::now() + Duration::from_secs(10);
    while Instant::now() < deadline {
        from.put(key, "hello").wait().expect("a put");
        if let Ok(Some(sample)) = subscriber.recv_timeout(Duration::from_millis(100)) {
            assert_eq!(sample.payload().to_bytes().as_ref(), b"hello");
            return true;
        }
    }
    false
}

/// What the registry answers, or the error that it answers.
pub fn ask(session: &Session, selector: &str) -> Result<Value, String> {
    let deadline = Instant::now() + DEADLINE;
    loop {
        assert!(Instant::now() < deadline, "{selector} is not answered");
        let replies = session.get(selector).timeout(Duration::from_secs(5)).wait();
        let reply = replies.expect("a query").into_iter().next();
        if let Some(reply) = reply {
            return read(reply);
        }
    }
}

/// Asks until the answer is what it should be.
pub fn answers(session: &Session, selector: &str, is_so: impl Fn(&Value) -> bool) -> Value {
    let deadline = Instant::now() + DEADLINE;
    loop {
        let answer = ask(session, selector).expect("an answer");
        if is_so(&answer) {
            return answer;
        }
        assert!(Instant::now() < deadline, "{selector}: still {answer:#}");
    }
}

/// What the admin space tells there, if anything.
pub fn admin(session: &Session, key: &str) -> Option<String> {
    let replies = session.get(key).timeout(PATIENCE).wait();
    let told: Vec<_> = (replies.expect("a query").into_iter())
        .filter_map(|reply| reply.into_result().ok())
        .map(|sample| String::from_utf8_lossy(&sample.payload().to_bytes()).into_owned())
        .collect();
    (!told.is_empty()).then(|| told.concat())
}

/// What comes back for a new text, if anything does.
pub fn change(session: &Session, selector: &str, text: &str) -> Option<Result<Value, String>> {
    let replies = session.get(selector).payload(text).timeout(PATIENCE);
    let reply = replies.wait().expect("a query").into_iter().next()?;
    Some(read(reply))
}

fn read(reply: Reply) -> Result<Value, String> {
    match reply.into_result() {
        Ok(sample) => Ok(serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON")),
        Err(error) => Err(String::from_utf8_lossy(&error.payload().to_bytes()).into_owned()),
    }
}
