//! Declares the presence of a program without a router: its liveliness token, and the answers to other programs that wait
//! until their declarations are known ([`EstablishedWait`](crate::core::peers::EstablishedWait)).
use zenoh::{
    liveliness::LivelinessToken,
    query::{Query, Queryable},
    Session, Wait,
};

use crate::{
    core::{key::KeySpace, peers},
    error::Error,
};

/// The declared presence of a program. Dropping it ends it.
pub(super) struct Presence {
    _answers: Queryable<()>,
    _token: LivelinessToken,
}

impl Presence {
    /// Declares the presence of a program of the robot of `place`.
    pub(super) fn declare(session: &Session, place: &KeySpace) -> Result<Self, Error> {
        let key = peers::token(place, &session.zid().to_string());
        let key_of_answers = key.clone();
        let answer = move |query: Query| {
            if let Err(error) = query.reply(&key_of_answers, "").wait() {
                tracing::debug!("cannot answer a program that waits: {error}");
            }
        };
        let refused = || Error::zenoh("cannot declare the robot's presence");
        let answers = session.declare_queryable(&key).callback(answer);
        let answers = answers.wait().map_err(refused())?;
        let token = session.liveliness().declare_token(key).wait();
        Ok(Self {
            _answers: answers,
            _token: token.map_err(refused())?,
        })
    }
}
