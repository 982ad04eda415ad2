//! Replies to queries: with a document in JSON, or with the text of an error.
use serde::Serialize;
use zenoh::{bytes::Encoding, query::Query, Wait};

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
