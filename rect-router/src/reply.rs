//! Replies to queries: with a document in JSON, or with the text of an error.
use std::sync::mpsc::{self, Receiver, TrySendError};

use serde::Serialize;
use zenoh::{bytes::Encoding, query::Query, Session, Wait};

/// Replies at `key` with a document, or with an error.
pub fn reply<T: Serialize>(query: &Query, key: &str, answer: Result<T, String>) {
    let json = answer
        .and_then(|document| serde_json::to_vec(&document).map_err(|error| error.to_string()));
    let replied = match json {
        Ok(json) => query
            .reply(key, json)
            .encoding(Encoding::APPLICATION_JSON)
            .wait(),
        Err(error) => query.reply_err(error).encoding(Encoding::TEXT_PLAIN).wait(),
    };
    // Sending fails if the one who asks has disconnected.
    if let Err(error) = replied {
        tracing::debug!("cannot send a reply about {key}: {error}");
    }
}

/// Declares a queryable for a thread that answers one query after the other, since that takes time and must not block Zenoh's own threads.
/// At most `max` queries wait; further ones are answered with the error `busy`. The queue ends with the session.
///
/// # Errors
/// Fails if the queryable cannot be declared.
pub fn queue(
    session: &Session,
    key: &str,
    max: usize,
    busy: &'static str,
) -> zenoh::Result<Receiver<Query>> {
    let (queries, next) = mpsc::sync_channel(max);
    let key_of_answer = key.to_owned();
    let on_query = move |query: Query| {
        if let Err(TrySendError::Full(query)) = queries.try_send(query) {
            reply::<()>(&query, &key_of_answer, Err(busy.to_owned()));
        }
    };
    let queryable = session.declare_queryable(key).callback(on_query);
    queryable.background().wait()?;
    Ok(next)
}
