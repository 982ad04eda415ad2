//! Owns changing a robot's connections from elsewhere: `<fleet>/<robot>/@rect/@config/connections`, a query without a
//! payload to read and one with the new text to change. Who may is Zenoh's access control to decide, for which the key has
//! a part of its own (`@config`) that no rule matches by chance.
use std::sync::Arc;

use serde::Serialize;
use serde_json::Value;
use zenoh::{bytes::Encoding, query::Query, Session, Wait};

use crate::connections::{Changes, Connections};

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

/// Answers until its session is closed.
pub fn serve(session: &Session, own: &str, connections: Arc<Connections>) -> zenoh::Result<()> {
    let key = format!("{own}/@config/connections");
    let key_of_answer = key.clone();
    let on_query = move |query: Query| {
        let replied = match answer(&query, &connections) {
            Ok(json) => query
                .reply(&key_of_answer, json.to_string())
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
            Err(wrong) => query.reply_err(wrong).encoding(Encoding::TEXT_PLAIN).wait(),
        };
        if let Err(error) = replied {
            tracing::debug!("who asked for the configuration got no answer: {error}");
        }
    };
    let queryable = session.declare_queryable(key).callback(on_query);
    queryable.background().wait()
}

fn answer(query: &Query, connections: &Connections) -> Result<Value, String> {
    let (mut expected, mut by) = (None, "somebody who does not say");
    for (key, value) in query.parameters().iter() {
        match key {
            "expect" => expected = Some(value),
            "by" => by = value,
            _ if key.is_empty() || key.starts_with('_') => {}
            _ => {
                return Err(format!(
                    "`{key}` is unknown; known are expect (a revision) and by (who)"
                ))
            }
        }
    }
    let json = |value: Result<Value, serde_json::Error>| value.map_err(|error| error.to_string());
    let Some(payload) = query.payload() else {
        let (text, revision) = connections.text().map_err(|error| error.to_string())?;
        return json(serde_json::to_value(Read { revision, text }));
    };
    let text = payload
        .try_to_string()
        .map_err(|_| "the new connections are no text (UTF-8)".to_owned())?;
    let (changes, revision) = connections
        .replace(&text, expected)
        .map_err(|error| error.to_string())?;
    tracing::info!("the connections are changed by {by}: {changes}");
    json(serde_json::to_value(Changed { revision, changes }))
}
