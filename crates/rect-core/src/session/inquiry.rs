//! Decides how a request to services is sent, and what each reply to it means.
use std::time::Duration;

use crate::{
    catalogue::Instance,
    driver::{Get, Sample, Target},
    message::{
        payload::Payload,
        request::{
            count_of_replies, error_from_payload, is_timeout, timeout_ms, RequestHeader,
            SHARED_REPLY,
        },
        urgency::Urgency,
    },
    name::{key::KeySpace, topic::Topic, Name},
    session::{request_ids::RequestIds, requester_end::announcement},
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
    /// The number of replies, without errors.
    replies: u32,
    /// The number of replies that the last one of a stream states.
    stated: Option<u32>,
    has_ended: bool,
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
        /// Whether other programs of that robot may have received the request, too, because they are allowed to serve the topic.
        is_shared: bool,
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
            replies: 0,
            stated: None,
            has_ended: false,
        }
    }

    /// Creates another request to the same service. It has an id of its own, and no reply yet.
    #[must_use]
    pub fn another(&self, timeout: Duration, ids: &RequestIds) -> Self {
        let (place, robot, topic) = (self.place.clone(), self.robot.clone(), self.topic.clone());
        Self::new(place, robot, topic, timeout, ids)
    }

    /// Requests several replies, the last of which is marked.
    #[must_use]
    pub fn stream(mut self) -> Self {
        self.header.is_stream = true;
        self
    }

    /// Returns the query to send.
    pub fn get(&self, payload: Payload, urgency: Urgency) -> Get {
        self.query(&self.header, self.timeout, payload, urgency)
    }

    /// Returns the query to send, also repeatedly, if only that run of a program may carry out the request, at most once. `left` is
    /// the time left for the reply.
    pub fn get_once(
        &self,
        once_by: Instance,
        left: Duration,
        payload: Payload,
        urgency: Urgency,
    ) -> Get {
        let header = RequestHeader {
            timeout_ms: timeout_ms(left),
            once_by: Some(once_by),
            ..self.header.clone()
        };
        self.query(&header, left, payload, urgency)
    }

    fn query(
        &self,
        header: &RequestHeader,
        timeout: Duration,
        payload: Payload,
        urgency: Urgency,
    ) -> Get {
        Get {
            payload: Some(payload),
            attachment: Some(header.encode()),
            qos: urgency.qos(),
            target: Target::All,
            ..Get::new(
                self.place.service(self.robot.as_ref(), &self.topic),
                timeout,
            )
        }
    }

    /// Returns the header of the request.
    pub fn header(&self) -> &RequestHeader {
        &self.header
    }

    /// Returns the meaning of a reply; `None` for the mark that ends a stream.
    pub fn on_reply(&mut self, reply: Result<Sample, Payload>) -> Option<ReplyKind> {
        Some(match reply {
            Ok(Sample {
                attachment: Some(attachment),
                ..
            }) if self.header.is_stream && count_of_replies(&attachment).is_some() => {
                self.stated = count_of_replies(&attachment);
                return None;
            }
            Ok(Sample {
                key,
                payload,
                attachment,
                ..
            }) => match self.place.robot_of(&key) {
                Some(sender) => {
                    self.replies += 1;
                    ReplyKind::Answer {
                        sender,
                        payload,
                        is_shared: attachment.is_some_and(|mark| mark[..] == SHARED_REPLY),
                    }
                }
                None => ReplyKind::NotOfARobot { key },
            },
            Err(error) => {
                let (robot, payload) = error_from_payload(error);
                if is_timeout(robot.as_ref(), &payload) {
                    self.has_ended = true;
                    return Some(ReplyKind::TimedOut);
                }
                self.has_ended |= self.robot.is_some();
                // Only the robot that was asked can reply, whichever name the error contains.
                let robot = robot.map(|robot| self.robot.clone().unwrap_or(robot));
                ReplyKind::Error { robot, payload }
            }
        })
    }

    /// Returns whether a service has replied.
    pub fn is_started(&self) -> bool {
        self.replies > 0
    }

    /// Returns whether the request is complete after its last reply. A stream is not if a reply is missing, or the mark of the last one.
    pub fn is_complete(&self) -> bool {
        !self.header.is_stream || self.has_ended || self.stated == Some(self.replies)
    }

    /// Handles that the program has closed the request. Returns the query that announces that, the first time. `None` if the service has
    /// replied, or the time is up, so that it does not wait for that.
    pub fn close(&mut self) -> Option<Get> {
        let is_single = self.robot.is_some() && !self.header.is_stream;
        let is_finished =
            self.has_ended || self.stated.is_some() || (is_single && self.replies > 0);
        self.has_ended = true;
        (!is_finished).then(|| {
            announcement(
                &self.place,
                self.robot.as_ref(),
                &self.topic,
                self.header.id,
            )
        })
    }

    /// Describes the expected reply, for the text of a timeout.
    pub fn expected(&self) -> String {
        format!("reply about {}", self.topic)
    }

    /// Returns the keys of the robot whose program sends the request.
    pub fn place(&self) -> &KeySpace {
        &self.place
    }

    /// Returns the topic of the service.
    pub fn topic(&self) -> &Topic {
        &self.topic
    }

    /// The time within which all services have to reply.
    pub fn timeout(&self) -> Duration {
        self.timeout
    }
}
