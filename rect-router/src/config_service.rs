//! Owns changing a robot's connections from elsewhere: `<fleet>/<robot>/@rect/@config/connections`, a query without a
//! payload to read, one with the new text to change all, `?add` with one connection, `?remove` with the name of one. Who may is
//! Zenoh's access control to decide, for which the key has a part of its own (`@config`) that no rule matches by chance.
use std::{
    sync::{
        mpsc::{self, TrySendError},
        Arc,
    },
    thread,
};

use rect::core::named_connection::{ADD, CONFIG, REMOVE};
use serde::Serialize;
use serde_json::Value;
use zenoh::{bytes::Encoding, query::Query, Session, Wait};

use crate::connections::{Changes, Connections, Edit};

/// What a reader gets.
#[derive(Serialize)]
struct Read {
    revision: String,
    text: String,
}

/// What who changed something gets.
#[derive(Serialize)]
struct Changed {
    revision: String,
    #[serde(flatten)]
    changes: Changes,
}

/// So many questions may wait for the one before them; who asks when there are more is told so.
const WAITING: usize = 16;

/// Answers until its session is closed.
pub fn serve(session: &Session, own: &str, connections: Arc<Connections>) -> zenoh::Result<()> {
    let key = format!("{own}/{CONFIG}");
    let key_of_answer = key.clone();
    let (queries, next) = mpsc::sync_channel(WAITING);
    // A change takes its time, and Zenoh's own threads have others to serve.
    thread::Builder::new()
        .name("settings".to_owned())
        .spawn(move || {
            for query in &next {
                answer(query, &key_of_answer, &connections);
            }
        })?;
    let on_query = move |query: Query| {
        if let Err(TrySendError::Full(query)) = queries.try_send(query) {
            let busy = "others are changing the connections; try again";
            told(query.reply_err(busy).encoding(Encoding::TEXT_PLAIN).wait());
        }
    };
    let queryable = session.declare_queryable(key).callback(on_query);
    queryable.background().wait()
}

/// Answers, and then does what is asked for.
fn answer(query: Query, key: &str, connections: &Connections) {
    // Its end, by which Zenoh knows that no more answers come, is sent where it is dropped.
    let reply = |query: Query, said: Result<Value, String>| {
        told(match said {
            Ok(json) => query
                .reply(key, json.to_string())
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
            Err(wrong) => query.reply_err(wrong).encoding(Encoding::TEXT_PLAIN).wait(),
        });
    };
    let Asked { edit, expected, by } = match Asked::by(&query) {
        Ok(asked) => asked,
        Err(wrong) => return reply(query, Err(wrong)),
    };
    let Some(edit) = edit else {
        return reply(query, read(connections));
    };
    let mut waits = Some(query);
    let done = connections.edit(&edit, expected.as_deref(), |changes, revision| {
        tracing::info!("the connections are changed by {by}: {changes}");
        if let Some(query) = waits.take() {
            let (revision, changes) = (revision.to_owned(), changes.clone());
            reply(query, json(&Changed { revision, changes }));
        }
    });
    if let (Err(error), Some(query)) = (done, waits) {
        reply(query, Err(error.to_string()));
    }
}

fn told(replied: zenoh::Result<()>) {
    if let Err(error) = replied {
        tracing::debug!("who asked for the configuration got no answer: {error}");
    }
}

fn read(connections: &Connections) -> Result<Value, String> {
    let (text, revision) = connections.text().map_err(|error| error.to_string())?;
    json(&Read { revision, text })
}

fn json(answer: &impl Serialize) -> Result<Value, String> {
    serde_json::to_value(answer).map_err(|error| error.to_string())
}

/// What somebody wants.
struct Asked {
    /// What is to change; none: to read.
    edit: Option<Edit>,
    expected: Option<String>,
    by: String,
}

impl Asked {
    fn by(query: &Query) -> Result<Self, String> {
        let (mut expected, mut by) = (None, "somebody who does not say");
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
                        "`{key}` is unknown; known are add and remove (one connection), expect (a revision) and by (who)"
                    ))
                }
            }
        }
        let text = query.payload().map(|payload| payload.try_to_string());
        let text = text
            .transpose()
            .map_err(|_| "the new connections are no text (UTF-8)".to_owned())?;
        Ok(Self {
            edit: text.map(|text| edit(text.into_owned())),
            expected,
            by: by.to_owned(),
        })
    }
}
