//! Defines the actions that a driver asks its executor to perform on Zenoh.
use std::time::Duration;

use super::{Id, QueryId};
use crate::message::{payload::Payload, urgency::Qos};

/// An action on a Zenoh session.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Declare something. If that fails while the handle is being created, the program gets the error.
    Declare {
        /// Name of the declaration in further actions and events.
        id: Id,
        /// The entity to declare.
        declaration: Declaration,
    },
    /// End a declaration. No event follows.
    Undeclare {
        /// The declaration.
        id: Id,
    },
    /// Publish through a declared publisher.
    Put {
        /// The publisher.
        publisher: Id,
        /// Bytes and encoding.
        payload: Payload,
        /// The attachment, if there is one.
        attachment: Option<Vec<u8>>,
    },
    /// Publish a rare message without a publisher.
    PutOnce {
        /// The key.
        key: String,
        /// Bytes and encoding.
        payload: Payload,
        /// Zenoh's quality of service.
        qos: Qos,
    },
    /// Publish a retained message without a publisher.
    PutRetained {
        /// The key.
        key: String,
        /// Bytes and encoding; `None`: the topic is forgotten.
        payload: Option<Payload>,
        /// Zenoh's quality of service.
        qos: Qos,
        /// The attachment.
        attachment: Vec<u8>,
        /// The number of the message at its source, for zenoh-ext.
        number: u32,
    },
    /// Send a query. Each reply becomes an [`Event::Reply`](super::Event::Reply), and exactly one
    /// [`Event::Ended`](super::Event::Ended) follows, also if the query cannot be sent.
    Get {
        /// Name of the query in its events.
        id: Id,
        /// The query.
        get: Get,
    },
    /// Answer a query that arrived at a queryable.
    Answer {
        /// The query.
        query: QueryId,
        /// The answer.
        answer: Answer,
    },
    /// Answer a query with the values of retained topics.
    AnswerRetained {
        /// The query.
        query: QueryId,
        /// The values; none ends the query.
        replies: Vec<RetainedReply>,
    },
}

/// The answer to a tool that asks for the value of a topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RetainedReply {
    /// The key.
    pub key: String,
    /// The value.
    pub payload: Payload,
    /// The attachment, as of the message.
    pub attachment: Vec<u8>,
    /// The number of the value, for zenoh-ext, which tells old values from new ones by it.
    pub number: u32,
}

/// An entity that a driver declares.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Declaration {
    /// A publisher.
    Publisher {
        /// Its key.
        key: String,
        /// Zenoh's quality of service of its messages.
        qos: Qos,
        /// Whether to report with [`Event::Matching`](super::Event::Matching), now and after each change, whether
        /// subscribers match it.
        observes_matching: bool,
    },
    /// A subscriber.
    Subscriber {
        /// Its key expression.
        key: String,
    },
    /// A queryable. A complete one can answer a query alone that requests a single answer.
    Queryable {
        /// Its key.
        key: String,
        /// Whether it is complete.
        complete: bool,
    },
    /// A liveliness token.
    LivelinessToken {
        /// Its key.
        key: String,
    },
    /// A subscriber of liveliness tokens, which also gets those that exist already.
    LivelinessSubscriber {
        /// Its key expression.
        key: String,
    },
    /// A listener for the links of the Zenoh session, without those that are up already.
    LinkListener,
}

/// A query.
#[derive(Clone, Debug, PartialEq)]
pub struct Get {
    /// Key expression, with parameters after a `?`.
    pub selector: String,
    /// Whether it asks for liveliness tokens. If so, only the selector and the timeout apply.
    pub liveliness: bool,
    /// Bytes and encoding, if there are any.
    pub payload: Option<Payload>,
    /// The attachment, if there is one.
    pub attachment: Option<Vec<u8>>,
    /// Zenoh's quality of service.
    pub qos: Qos,
    /// Which queryables get the query.
    pub target: Target,
    /// Time after which Zenoh ends the query.
    pub timeout: Duration,
}

/// Which queryables get a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// One that matches; a complete one if there is one.
    BestMatching,
    /// All that match.
    All,
}

/// The answer to a query.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// A reply on a key.
    Reply {
        /// The key.
        key: String,
        /// Bytes and encoding.
        payload: Payload,
    },
    /// An error.
    Error(Payload),
    /// No answer: the query ends.
    None,
}

impl Get {
    /// Creates a query without payload for data, to one queryable, with the quality of service of normal messages.
    pub fn new(selector: impl Into<String>, timeout: Duration) -> Self {
        Self {
            selector: selector.into(),
            liveliness: false,
            payload: None,
            attachment: None,
            qos: crate::message::urgency::Urgency::Normal.qos(),
            target: Target::BestMatching,
            timeout,
        }
    }

    /// Creates a query for the liveliness tokens that match `key`.
    pub fn liveliness(key: impl Into<String>, timeout: Duration) -> Self {
        Self {
            liveliness: true,
            ..Self::new(key, timeout)
        }
    }
}
