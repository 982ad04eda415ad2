//! Opens Zenoh sessions with a router and sends queries through them.
use std::time::{Duration, Instant};

use serde_json::{json, Value};
use zenoh::{query::Reply, Config, Session, Wait};

use super::DEADLINE;

/// Timeout of a query that may remain unanswered.
const QUERY_TIMEOUT: Duration = Duration::from_secs(10);

/// Opens a client session with the router at `endpoint`, with additional settings.
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

/// Opens a client session with the router at `endpoint`.
pub fn client(endpoint: &str) -> Session {
    client_with(endpoint, &[]).unwrap_or_else(|error| panic!("no session with {endpoint}: {error}"))
}

/// Publishes repeatedly until a message arrives, because a subscription takes a moment to reach the publisher. Returns
/// whether one arrived within 10 s.
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

/// Queries the registry until it replies, and returns the reply or the error that it contains. A query that was on a link
/// when it was replaced gets no reply, only Zenoh's timeout, and is repeated.
pub fn ask(session: &Session, selector: &str) -> Result<Value, String> {
    let deadline = Instant::now() + DEADLINE;
    loop {
        assert!(Instant::now() < deadline, "{selector} is not answered");
        let replies = session.get(selector).timeout(Duration::from_secs(5)).wait();
        let answer = replies.expect("a query").into_iter().next().map(read);
        if let Some(answer) = answer.filter(|answer| *answer != Err("Timeout".to_owned())) {
            return answer;
        }
    }
}

/// Repeats a query until `is_expected` accepts the reply, and returns that reply.
pub fn answers(session: &Session, selector: &str, is_expected: impl Fn(&Value) -> bool) -> Value {
    let deadline = Instant::now() + DEADLINE;
    loop {
        let answer = ask(session, selector).expect("an answer");
        if is_expected(&answer) {
            return answer;
        }
        assert!(Instant::now() < deadline, "{selector}: still {answer:#}");
    }
}

/// Returns the replies of the admin space at `key`, or `None` if there are none.
pub fn admin(session: &Session, key: &str) -> Option<String> {
    let replies = session.get(key).timeout(QUERY_TIMEOUT).wait();
    let texts: Vec<_> = (replies.expect("a query").into_iter())
        .filter_map(|reply| reply.into_result().ok())
        .map(|sample| String::from_utf8_lossy(&sample.payload().to_bytes()).into_owned())
        .collect();
    (!texts.is_empty()).then(|| texts.concat())
}

/// Sends a query with `text` as its payload, and returns the reply, or `None` if there is none.
pub fn change(session: &Session, selector: &str, text: &str) -> Option<Result<Value, String>> {
    let replies = session.get(selector).payload(text).timeout(QUERY_TIMEOUT);
    let reply = replies.wait().expect("a query").into_iter().next()?;
    Some(read(reply))
}

fn read(reply: Reply) -> Result<Value, String> {
    match reply.into_result() {
        Ok(sample) => Ok(serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON")),
        Err(error) => Err(String::from_utf8_lossy(&error.payload().to_bytes()).into_owned()),
    }
}
