//! Opens a session with a router, within a time limit, and asks the router which robot it serves.
use std::{thread, time::Duration};

use tokio::sync::oneshot;
use zenoh::{Config, Session, Wait};

use crate::core::router::{robot_of_router, ROBOT_TIMEOUT};

/// What Zenoh needs to report why it can't connect: as a client it reports only that it could not.
const DIAGNOSIS: [(&str, &str); 5] = [
    ("mode", "\"peer\""),
    ("connect/exit_on_failure", "true"),
    ("listen/endpoints", "[]"),
    ("scouting/gossip/enabled", "false"),
    ("open/return_conditions/connect_scouted", "false"),
];

/// Makes one attempt to open a session.
///
/// # Errors
/// The reason why the session does not open; `None`: it took longer than `limit`.
pub(super) async fn open(config: Config, limit: Duration) -> Result<Session, Option<String>> {
    let (done, opened) = oneshot::channel();
    // Zenoh blocks the thread, for minutes where an address does not answer. A thread of our own can be left behind; a
    // runtime would wait for its threads.
    let attempt = move || {
        if let Err(Ok(session)) = done.send(attempt(config)) {
            // Nobody waits for it any more.
            if let Err(error) = session.close().wait() {
                tracing::debug!("the session does not close: {error}");
            }
        }
    };
    let thread = thread::Builder::new().name("rect-open".into());
    if let Err(error) = thread.spawn(attempt) {
        return Err(Some(format!("no thread can be started: {error}")));
    }
    match tokio::time::timeout(limit, opened).await {
        Ok(Ok(opened)) => opened.map_err(Some),
        Ok(Err(_)) => Err(Some("Zenoh panicked".to_owned())),
        Err(_) => Err(None),
    }
}

fn attempt(config: Config) -> Result<Session, String> {
    let error = match zenoh::open(config.clone()).wait() {
        Ok(session) => return Ok(session),
        Err(error) => error,
    };
    Err(reason(config).unwrap_or_else(|| error.to_string()))
}

/// Returns why a router can't be reached; `None`: now it can be.
fn reason(mut config: Config) -> Option<String> {
    for (key, value) in DIAGNOSIS {
        config.insert_json5(key, value).ok()?;
    }
    match zenoh::open(config).wait() {
        Ok(session) => {
            if let Err(error) = session.close().wait() {
                tracing::debug!("the session does not close: {error}");
            }
            None
        }
        Err(error) => Some(error.to_string()),
    }
}

/// Returns the keys of the liveliness tokens that name the robot of the session's router; none where it serves no robot, or
/// does not answer in time. The router answers by itself: nothing goes over the air.
pub(super) async fn tokens_of_router(session: &Session) -> Vec<String> {
    let Some(id) = session.info().routers_zid().await.next() else {
        return Vec::new();
    };
    let asked = session
        .liveliness()
        .get(robot_of_router(&id.to_string()))
        .timeout(ROBOT_TIMEOUT);
    let replies = match asked.await {
        Ok(replies) => replies,
        Err(error) => {
            tracing::debug!("the router is not asked which robot it serves: {error}");
            return Vec::new();
        }
    };
    let mut tokens = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        tokens.extend(
            reply
                .into_result()
                .ok()
                .map(|sample| sample.key_expr().as_str().to_owned()),
        );
    }
    tokens
}
