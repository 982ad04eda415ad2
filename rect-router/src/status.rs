//! Reports links in the admin space: `@/<zid>/router/ble` answers with a JSON array of one object for each Zenoh runtime of the
//! process and its Bluetooth links, and `@/<zid>/router/any` with an array of the links over several paths. Zenoh's access control
//! decides who may read them, as for the rest of `@/**`.
use serde::Serialize;
use zenoh::{Session, Wait};
use zenoh_link_ble::status::nodes;

use crate::{paths, reply::reply};

/// Declares the queryables, which answer until the session is closed.
///
/// # Errors
/// Zenoh's error if one cannot be declared.
pub fn serve(session: &Session) -> zenoh::Result<()> {
    serve_document(session, "ble", nodes)?;
    serve_document(session, "any", paths::links)
}

/// Returns the key of a document.
pub fn key(session: &Session, name: &str) -> String {
    format!("@/{}/router/{name}", session.zid())
}

fn serve_document<T: Serialize>(
    session: &Session,
    name: &str,
    document: impl Fn() -> T + Send + Sync + 'static,
) -> zenoh::Result<()> {
    let key = key(session, name);
    let key_of_answer = key.clone();
    let queryable = session
        .declare_queryable(key)
        .callback(move |query| reply(&query, &key_of_answer, Ok(document())));
    queryable.background().wait()
}
