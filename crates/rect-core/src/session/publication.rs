//! Decides how a message is published: its key and its number.
use std::time::Duration;

use crate::{
    message::{
        attachment::{Attachment, Encoded, Sent},
        urgency::{Qos, Urgency},
    },
    name::{key::KeySpace, topic::Topic, Name},
};

/// The size in bytes from which a payload may have to wait for room on a link, so that a thread that must not wait does
/// not send it itself.
pub const LARGE_BYTES: usize = 16 * 1024;

/// The topic, recipient and urgency of a publisher's messages.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct PublicationKey {
    /// The topic.
    pub topic: Topic,
    /// The one robot that gets the messages. `None`: all subscribers get them.
    pub recipient: Option<Name>,
    /// The urgency of the messages.
    pub urgency: Urgency,
    /// Whether the messages expire. They are dropped where others would wait.
    pub expires: bool,
}

impl PublicationKey {
    /// Returns the key of the messages.
    pub fn key(&self, place: &KeySpace) -> String {
        match &self.recipient {
            None => place.publication(&self.topic),
            Some(recipient) => place.message(recipient, &self.topic),
        }
    }

    /// Returns the quality of service of the messages.
    pub fn qos(&self) -> Qos {
        qos(self.urgency, self.expires)
    }
}

/// Returns the quality of service of messages of an urgency that expire or not. An overloaded link refuses a message that
/// expires, in place of storing it.
pub fn qos(urgency: Urgency, expires: bool) -> Qos {
    let qos = urgency.qos();
    match expires {
        true => Qos {
            express: true,
            ..qos.drop_when_congested()
        },
        false => qos,
    }
}

/// Numbers the messages of one publisher.
#[derive(Debug)]
pub struct Numbering {
    source: u16,
    next: u32,
}

impl Numbering {
    /// Begins with the number 0. `source` is a random number that identifies the publisher.
    pub fn new(source: u16) -> Self {
        Self { source, next: 0 }
    }

    /// Returns the attachment of the next message. `lifetime` is the time after which the message expires, if it does.
    pub fn attachment(&self, sent: Sent, lifetime: Option<Duration>) -> Encoded {
        let attachment = Attachment {
            source: self.source,
            sequence: self.next,
            sent,
            lifetime_ms: lifetime.map(in_ms),
        };
        attachment.encode()
    }

    /// Handles that the message was sent. A message that could not be sent leaves its number to the next one.
    pub fn on_sent(&mut self) {
        self.next = self.next.wrapping_add(1);
    }
}

/// Returns a lifetime in milliseconds, rounded up: at least 1, at most 49 days.
fn in_ms(lifetime: Duration) -> u32 {
    let ms = lifetime.as_nanos().div_ceil(1_000_000).max(1);
    u32::try_from(ms).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn destination(topic: usize, recipient: Option<&str>) -> PublicationKey {
        PublicationKey {
            topic: Topic::new(&format!("t{topic}")).expect("valid topic"),
            recipient: recipient.map(|name| Name::new(name).expect("valid name")),
            urgency: Urgency::Normal,
            expires: false,
        }
    }

    #[test]
    fn numbers_count_the_messages_that_were_sent() {
        let mut numbering = Numbering::new(7);
        let number = |numbering: &Numbering| {
            let attachment = Attachment::decode(&numbering.attachment(Sent::At(1000), None));
            attachment.expect("an attachment").sequence
        };
        assert_eq!(number(&numbering), 0);
        assert_eq!(number(&numbering), 0, "it was not sent");
        numbering.on_sent();
        assert_eq!(number(&numbering), 1);
        numbering.next = u32::MAX;
        numbering.on_sent();
        assert_eq!(number(&numbering), 0);
    }

    #[test]
    fn messages_to_one_robot_have_a_key_of_their_own() {
        let name = |text| Name::new(text).expect("valid name");
        let (fleet, robot) = (name("rect"), name("wombat-1"));
        let place = KeySpace { fleet, robot };
        assert_eq!(destination(1, None).key(&place), "rect/wombat-1/t1");
        let directed = destination(1, Some("wombat-2")).key(&place);
        assert_eq!(directed, "rect/wombat-1/to/wombat-2/t1");
    }
}
