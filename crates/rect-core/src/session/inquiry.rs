//! Decides how a request to services is sent, and what each reply to it means.
use std::time::Duration;

use crate::{
    driver::{Get, Sample, Target},
    message::{
        payload::Payload,
        request::{error_from_payload, is_timeout, RequestHeader},
        urgency::Urgency,
    },
    name::{key::KeySpace, topic::Topic, Name},
    session::request_ids::RequestIds,
};

/// The number of replies that may wait for the program. A service that sends more waits.
pub const MAX_REPLIES: usize = 64;

/// A request to the service of one robot, or of all robots.
#[derive(Clone, Debug)]
pub struct Inquiry {
    place: KeySpace,
    robot: Option<Name>,
    topic: Topic,
    timeout: Duration,
    header: RequestHeader,
}

/// The meaning of a reply.
#[derive(Clone, Debug, PartialEq)]
pub enum ReplyKind {
    /// A service replied. The payload may still be encoded by a codec.
    Answer {
        /// The robot that replied.
        sender: Name,
        /// Its reply.
        payload: Payload,
    },
    /// A service replied with an error.
    Error {
        /// The robot that replied. `None` if it does not use RECT.
        robot: Option<Name>,
        /// The error.
        payload: Payload,
    },
    /// The timeout has expired before all services had replied.
    TimedOut,
    /// The reply is not on the key of a robot.
    NotOfARobot {
        /// Its key.
        key: String,
    },
}

impl Inquiry {
    /// Creates a request of a program of the robot of `place` to the service `topic` of `robot`, or of all robots
    /// (`None`).
    pub fn new(
        place: KeySpace,
        robot: Option<Name>,
        topic: Topic,
        timeout: Duration,
        ids: &RequestIds,
    ) -> Self {
        Self {
            header: ids.header(&place, timeout),
            place,
            robot,
            topic,
            timeout,
        }
    }

    /// Returns the query to send.
    pub fn get(&self, payload: Payload, urgency: Urgency) -> Get {
        Get {
            payload: Some(payload),
            attachment: Some(self.header.encode()),
            qos: urgency.qos(),
            target: Target::All,
            ..Get::new(
                self.place.service(self.robot.as_ref(), &self.topic),
                self.timeout,
            )
        }
    }

    /// Returns the meaning of a reply.
    pub fn on_reply(&self, reply: Result<Sample, Payload>) -> ReplyKind {
        match reply {
            Ok(Sample { key, payload, .. }) => match self.place.address(&key) {
                Some(address) => ReplyKind::Answer {
                    sender: address.sender,
                    payload,
                },
                None => ReplyKind::NotOfARobot { key },
            },
            Err(error) => {
                let (robot, payload) = error_from_payload(error);
                if is_timeout(robot.as_ref(), &payload) {
                    return ReplyKind::TimedOut;
                }
                // Only the robot that was asked can reply, whichever name the error contains.
                let robot = robot.map(|robot| self.robot.clone().unwrap_or(robot));
                ReplyKind::Error { robot, payload }
            }
        }
    }

    /// Describes the expected reply, for the text of a timeout.
    pub fn expected(&self) -> String {
        format!("reply about {}", self.topic)
    }

    /// The time within which all services have to reply.
    pub fn timeout(&self) -> Duration {
        self.timeout
    }
}
