//! Owns what can go wrong in a session, with what to do about it.
use std::{path::PathBuf, time::Duration};

use crate::core::{
    codec::CodecError,
    login::LoginRefused,
    name::{Name, NameError},
    payload::{Payload, PayloadError},
    router::WrongRobot,
    topic::{Topic, TopicError},
    transfer::{Fault, OfferError, Refusal},
    wording,
};

/// Something did not work. Each text says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The name of a robot or fleet. Choose another.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A topic or pattern. Write it as the text says.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// A value that can't be sent or read as asked for.
    #[error(transparent)]
    Payload(#[from] PayloadError),
    /// A codec that does not fit, or a payload that is damaged.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// No router. Start one, or name another.
    #[error(
        "no router answers at {endpoint}: {reason}. `rect-router -l tcp/127.0.0.1:7447` starts one here; \
         another one is named by the option `router`, or by RECT_ENDPOINT"
    )]
    NoRouter {
        /// Where it was looked for.
        endpoint: String,
        /// What Zenoh says.
        reason: String,
    },
    /// The router asks for a login, and this program's is missing or wrong. Name the team's login file.
    #[error(transparent)]
    LoginRefused(#[from] LoginRefused),
    /// The router serves another robot than the program joins as. Join under the router's name, or at the right router.
    #[error(transparent)]
    WrongRobot(#[from] WrongRobot),
    /// A locator, or something else in the options, that Zenoh does not take.
    #[error("the option {what} can't be {value:?}: {reason}")]
    Option {
        /// Which.
        what: &'static str,
        /// What was given.
        value: String,
        /// What Zenoh says.
        reason: String,
    },
    /// Nobody has that service. Is the robot there, and does its program run?
    #[error("nobody serves {topic} at {robot}; robots there: {there}")]
    NoService {
        /// Who was asked; `*` for anyone.
        robot: String,
        /// For what.
        topic: String,
        /// Who is there.
        there: String,
    },
    /// It took too long. Ask again, allow more time, or look at the link (`rect connections`).
    #[error("no {what} within {}", wording::duration(*.after))]
    TimedOut {
        /// What was waited for.
        what: String,
        /// For how long.
        after: Duration,
    },
    /// The service answered with an error.
    #[error("{} answers with an error: {}", .robot.as_ref().map_or("the service", Name::as_str), said(.payload))]
    Service {
        /// Who answered; `None`: a stock program, which does not say.
        robot: Option<Name>,
        /// The error, as the service made it.
        payload: Payload,
    },
    /// Zenoh refuses.
    #[error("{what}: {reason}")]
    Zenoh {
        /// What was wanted.
        what: &'static str,
        /// What Zenoh says.
        reason: String,
    },
    /// A transfer is not taken there. Who is to receive it says what it takes (`receive_transfers`).
    #[error("{robot} does not take the transfer {topic}: {refusal}")]
    TransferRefused {
        /// Who was to receive it.
        robot: Name,
        /// About what.
        topic: Topic,
        /// Why.
        #[source]
        refusal: Refusal,
    },
    /// A transfer began and ended before all was there. The reason says whether to send it again.
    #[error("the transfer {topic} with {robot} did not get there: {fault}")]
    TransferFailed {
        /// Who is at the other end.
        robot: Name,
        /// About what.
        topic: Topic,
        /// Why.
        #[source]
        fault: Fault,
    },
    /// A file or folder of a transfer can't be used.
    #[error("{}: {reason}", .path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What the system says.
        #[source]
        reason: std::io::Error,
    },
    /// The name of what is transferred. Choose another.
    #[error(transparent)]
    Offer(#[from] OfferError),
    /// The session was closed.
    #[error("the session is closed")]
    Closed,
}

/// The beginning of an error's text.
fn said(payload: &Payload) -> String {
    let text = String::from_utf8_lossy(&payload.bytes);
    text.chars().take(500).collect()
}

impl From<std::convert::Infallible> for Error {
    fn from(never: std::convert::Infallible) -> Self {
        match never {}
    }
}

impl Error {
    pub(crate) fn zenoh(what: &'static str) -> impl FnOnce(zenoh::Error) -> Self {
        move |error| Self::Zenoh {
            what,
            reason: wording::with_causes(error.as_ref()),
        }
    }
}
