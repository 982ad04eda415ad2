//! Defines the events that an executor reports to a driver, and the driver's reaction.
use bytes::Bytes;

use super::{Id, QueryId};
use crate::message::payload::Payload;

/// An event on a Zenoh session.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A subscriber received a sample.
    Sample {
        /// The subscriber.
        id: Id,
        /// The sample.
        sample: Sample,
    },
    /// A reply to a query.
    Reply {
        /// The query.
        id: Id,
        /// The reply, or the payload of an error reply.
        reply: Result<Sample, Payload>,
    },
    /// A query has ended: no more replies follow.
    Ended {
        /// The query.
        id: Id,
    },
    /// A query arrived at a queryable.
    Query {
        /// The queryable.
        id: Id,
        /// Name of the query in the [answer](super::Action::Answer).
        query: QueryId,
        /// Its key expression.
        key: String,
        /// Bytes and encoding; empty if there are none.
        payload: Payload,
        /// The attachment, if there is one.
        attachment: Option<Bytes>,
    },
    /// Subscribers of a publisher appeared, or the last one disappeared.
    Matching {
        /// The publisher.
        id: Id,
        /// Whether there are subscribers.
        matching: bool,
    },
    /// A link of the Zenoh session came up or went down.
    Link {
        /// Whether it came up.
        up: bool,
        /// The method of the link, such as `ble`.
        method: String,
        /// The address of the peer.
        address: String,
    },
    /// The session is closed, or the program has closed the handle.
    Closed,
}

/// A sample of a subscriber, or the sample of a reply.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// The key.
    pub key: String,
    /// Bytes and encoding.
    pub payload: Payload,
    /// The attachment, if there is one.
    pub attachment: Option<Bytes>,
    /// Whether the key was deleted, for example by the end of a liveliness token.
    pub is_deleted: bool,
    /// Zenoh's priority, 1 to 7.
    pub priority: u8,
}

impl Sample {
    /// Zenoh's default priority, `Data`.
    pub const PRIORITY: u8 = 5;
}

/// A driver's reaction to an event.
#[derive(Clone, Debug, PartialEq, Eq)]
#[must_use]
pub struct Reaction<I> {
    /// Items to deliver to the program now.
    pub items: Vec<I>,
    /// Whether [`poll`](super::Driver::poll) has something to do.
    pub polls: bool,
}

impl<I> Reaction<I> {
    /// There is nothing to do.
    pub const NONE: Self = Self {
        items: Vec::new(),
        polls: false,
    };
    /// Poll the driver.
    pub const POLL: Self = Self {
        items: Vec::new(),
        polls: true,
    };

    /// Deliver these items.
    pub fn deliver(items: Vec<I>) -> Self {
        Self {
            items,
            polls: false,
        }
    }
}
