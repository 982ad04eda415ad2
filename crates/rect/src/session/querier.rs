//! Observes whether somebody serves what a program requests.
use std::sync::Arc;

use rect_core::session::served::Served;
use zenoh::{matching::MatchingListener, query::QueryTarget, Session, Wait};

use crate::error::Error;

/// A querier of Zenoh, which is declared for its reports alone: it has the router tell the session who serves the key. The
/// requests of that key are sent by the session.
#[derive(Debug)]
pub(super) struct Querier {
    pub(super) served: Arc<Served>,
    _listener: MatchingListener<()>,
    querier: zenoh::query::Querier<'static>,
}

impl Querier {
    pub(super) fn declare(session: &Session, key: String) -> Result<Self, Error> {
        // Services are complete. A recorder is not, and receives every request.
        let querier = session
            .declare_querier(key)
            .target(QueryTarget::AllComplete);
        let querier = querier.wait().map_err(refused)?;
        let served = Arc::new(Served::default());
        let reported = served.clone();
        let listener = querier
            .matching_listener()
            .callback(move |status| reported.on_matching(status.matching()))
            .wait()
            .map_err(refused)?;
        Ok(Self {
            served,
            querier,
            _listener: listener,
        })
    }

    /// Asks Zenoh whether somebody serves the key now. If it cannot say, somebody may.
    pub(super) fn is_served(&self) -> bool {
        let status = self.querier.matching_status().wait();
        status.map_or(true, |status| status.matching())
    }
}

fn refused(error: zenoh::Error) -> Error {
    Error::zenoh("cannot send the request")(error)
}
