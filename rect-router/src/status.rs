//! Reports the Bluetooth links in the admin space: `@/<zid>/router/ble` answers with a JSON array of one object for each Zenoh
//! runtime of the process. Zenoh's access control decides who may read it, as for the rest of `@/**`.

use zenoh::{bytes::Encoding, query::Query, Session, Wait};
use zenoh_link::ble::status::nodes;

/// Declares the queryable, which answers until the session is closed.
///
/// # Errors
/// Zenoh's error if it cannot be declared.
pub fn serve(session: &Session) -> zenoh::Result<()> {
    let key = format!("@/{}/router/ble", session.zid());
    let key_of_answer = key.clone();
    let queryable = session
        .declare_queryable(key)
        .callback(move |query| answer(&query, &key_of_answer));
    queryable.background().wait()
}

fn answer(query: &Query, key: &str) {
    let replied = match serde_json::to_vec(&nodes()) {
        Ok(status) => query
            .reply(key, status)
            .encoding(Encoding::APPLICATION_JSON)
            .wait(),
        Err(error) => query.reply_err(error.to_string()).wait(),
    };
    if let Err(error) = replied {
        tracing::debug!("cannot send a reply about the Bluetooth links: {error}");
    }
}
