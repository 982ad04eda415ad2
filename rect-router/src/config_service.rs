//! Implements the config service, through which other robots read and change this robot's connections file.
//!
//! Its key is `<fleet>/<robot>/@rect/@config/connections`. A query without a payload reads the file, a query with a payload
//! replaces it, `?add` adds the connection in the payload, and `?remove` removes the connection named by the payload.
//! Zenoh's access control decides who may use the service; a rule for `**` does not match the key's `@config` part.
use std::{sync::Arc, thread};

use rect_core::registry::named_connection::{ADD, CONFIG, REMOVE};
use serde::Serialize;
use serde_json::Value;
use zenoh::{query::Query, Session};

use crate::{
    connections::{Changes, Connections, Edit},
    reply,
};

/// The reply to a query that reads the file.
#[derive(Serialize)]
struct ReadReply {
    revision: String,
    text: String,
}

/// The reply to a query that changes the file.
#[derive(Serialize)]
struct ChangeReply {
    revision: String,
    #[serde(flatten)]
    changes: Changes,
}

/// Maximum number of queries that wait for the one in progress; further queries are answered with an error.
const MAX_WAITING_QUERIES: usize = 16;

/// Declares the config service, which answers until the session is closed. `own` is the prefix of the robot's services,
/// `<fleet>/<robot>/@rect`.
///
/// # Errors
/// Fails if the queryable cannot be declared or the thread cannot be started.
pub fn serve(session: &Session, own: &str, connections: Arc<Connections>) -> zenoh::Result<()> {
    let key = format!("{own}/{CONFIG}");
    let busy = "too many queries are waiting to change the connections; try again";
    let next = reply::queue(session, &key, MAX_WAITING_QUERIES, busy)?;
    thread::Builder::new()
        .name("settings".to_owned())
        .spawn(move || {
            for query in &next {
                answer(query, &key, &connections);
            }
        })?;
    Ok(())
}

/// Answers a query, and then applies the change that it requests.
fn answer(query: Query, key: &str, connections: &Connections) {
    // Takes the query by value: dropping it tells Zenoh that no further reply follows.
    let reply = |query: Query, result: Result<Value, String>| {
        reply::reply(&query, key, result);
    };
    let ConfigRequest { edit, expected, by } = match ConfigRequest::parse(&query) {
        Ok(request) => request,
        Err(error) => return reply(query, Err(error)),
    };
    let Some(edit) = edit else {
        return reply(query, read(connections));
    };
    let mut unanswered = Some(query);
    let done = connections.edit(&edit, expected.as_deref(), |changes, revision| {
        tracing::info!("the connections are changed by {by}: {changes}");
        if let Some(query) = unanswered.take() {
            let (revision, changes) = (revision.to_owned(), changes.clone());
            reply(query, json(&ChangeReply { revision, changes }));
        }
    });
    if let (Err(error), Some(query)) = (done, unanswered) {
        reply(query, Err(error.to_string()));
    }
}

/// Returns the reply with the current text of the file.
fn read(connections: &Connections) -> Result<Value, String> {
    let (text, revision) = connections.text().map_err(|error| error.to_string())?;
    json(&ReadReply { revision, text })
}

fn json(answer: &impl Serialize) -> Result<Value, String> {
    serde_json::to_value(answer).map_err(|error| error.to_string())
}

/// A parsed query to the config service.
struct ConfigRequest {
    /// The change; `None` reads the file.
    edit: Option<Edit>,
    /// The revision that the file must have, if the query names one.
    expected: Option<String>,
    /// The author of the change, for the log.
    by: String,
}

impl ConfigRequest {
    fn parse(query: &Query) -> Result<Self, String> {
        let (mut expected, mut by) = (None, "an unnamed author");
        let mut edit: fn(String) -> Edit = Edit::Whole;
        for (key, value) in query.parameters().iter() {
            match key {
                "expect" => expected = Some(value.to_owned()),
                "by" => by = value,
                ADD => edit = Edit::Add,
                REMOVE => edit = Edit::Remove,
                _ if key.is_empty() || key.starts_with('_') => {}
                _ => {
                    return Err(format!(
                        "`{key}` is unknown; known are add and remove (one connection), expect (a revision) and by (the author)"
                    ))
                }
            }
        }
        let text = query.payload().map(|payload| payload.try_to_string());
        let text = text
            .transpose()
            .map_err(|_| "the new connections are not valid UTF-8 text".to_owned())?;
        Ok(Self {
            edit: text.map(|text| edit(text.into_owned())),
            expected,
            by: by.to_owned(),
        })
    }
}
