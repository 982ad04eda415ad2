//! Defines [`Entry`], one recorded message.
use std::{sync::Arc, time::Duration};

use rect_core::{
    clock::unix::since_1970,
    message::{encoding::Encoding, payload::Payload, urgency::Urgency, Message},
    name::{key::OWN, topic::Topic, Name},
};

use crate::schema::Foreign;

/// The kind of an entry of a retained topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RetainedKind {
    /// A value that was published while the recording ran, or that was retained when it began.
    Value,
    /// A value at the beginning of a file, which a file before it contains.
    Repeated,
    /// The robot has forgotten the topic: there is no payload.
    Forgotten,
}

impl RetainedKind {
    const ALL: [Self; 3] = [Self::Value, Self::Repeated, Self::Forgotten];

    /// Returns the name in a file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Value => "value",
            Self::Repeated => "repeated",
            Self::Forgotten => "forgotten",
        }
    }

    /// Returns the kind of that name. One of a later version is a value.
    pub fn named(name: &str) -> Self {
        let known = Self::ALL.into_iter().find(|kind| kind.name() == name);
        known.unwrap_or(Self::Value)
    }
}

/// A recorded message.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// The robot and the topic: `wombat-1/arm/angle`. A file of another program may have topics without a robot.
    pub topic: String,
    /// The one robot that the message was sent to. `None`: it was published to all.
    pub recipient: Option<String>,
    /// The bytes and their encoding, as the program received them.
    pub payload: Payload,
    /// The urgency with which the message was sent.
    pub urgency: Urgency,
    /// The number of the message at its publisher. 0 if the publisher does not count.
    pub sequence: u32,
    /// The number that identifies the publisher. `None`: it does not use RECT.
    pub publisher: Option<u16>,
    /// When it was recorded, since 1970 by the recorder's clock. The clock is read once, at the start of the recording, so
    /// that it cannot jump.
    pub logged: Duration,
    /// When it was sent, since 1970 by the sender's clock; [`logged`](Self::logged) if that is not known.
    pub sent: Duration,
    /// The kind of the entry of a retained topic. `None`: the message is not of a retained topic.
    pub retained: Option<RetainedKind>,
    /// The description of the channel that another program has recorded. `None`: a recorder of RECT has recorded the message.
    pub foreign: Option<Arc<Foreign>>,
}

impl Entry {
    /// Returns the entry of a message that arrived at a time.
    pub fn of(message: Message, logged: Duration) -> Self {
        Self {
            topic: format!("{}/{}", message.sender, message.topic.as_str()),
            retained: message
                .retained
                .map(|retained| match retained.is_forgotten {
                    true => RetainedKind::Forgotten,
                    false => RetainedKind::Value,
                }),
            recipient: message.recipient.map(|robot| robot.as_str().to_owned()),
            payload: message.payload,
            urgency: message.urgency,
            sequence: message.sequence.unwrap_or(0),
            publisher: message.publisher,
            logged,
            sent: message.sent_at.map_or(logged, since_1970),
            foreign: None,
        }
    }

    /// Returns the entry of a report of a robot about itself, a value in JSON. No message has such a topic.
    pub fn of_report(robot: &Name, subject: &str, json: Vec<u8>, logged: Duration) -> Self {
        Self {
            topic: format!("{robot}/{OWN}/{subject}"),
            recipient: None,
            payload: Payload::new(json, Encoding::JSON),
            urgency: Urgency::Normal,
            sequence: 0,
            publisher: None,
            logged,
            sent: logged,
            retained: None,
            foreign: None,
        }
    }

    /// Returns whether the entry is a report of a robot about itself, which no robot has published.
    pub fn is_report(&self) -> bool {
        let topic = self.topic.split_once('/').map(|(_, topic)| topic);
        topic.is_some_and(|topic| topic.split('/').next() == Some(OWN))
    }

    /// Returns the robot that sent the message, and the topic. `None` if the file's topic is not that of a robot.
    pub fn address(&self) -> Option<(Name, Topic)> {
        address(&self.topic)
    }

    /// Returns about how many bytes the entry takes in memory.
    pub fn bytes(&self) -> usize {
        self.payload.bytes.len() + self.topic.len() + size_of::<Self>()
    }
}

/// Returns the robot and the topic in the topic of a file; `None` if there is no robot in it.
pub fn address(topic: &str) -> Option<(Name, Topic)> {
    let (robot, topic) = topic.trim_start_matches('/').split_once('/')?;
    Some((Name::new(robot).ok()?, Topic::new(topic).ok()?))
}
