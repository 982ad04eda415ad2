//! Defines [`Message`], and [`Inbound`], which turns Zenoh samples into messages.
use super::{
    attachment::{Attachment, Sent},
    codec::CodecError,
    gaps::{Gaps, SenderCounts},
    key::{AddressError, KeySpace},
    name::Name,
    payload::Payload,
    topic::Topic,
    urgency::Urgency,
};

/// A message from another robot, or from another program of this robot.
#[derive(Clone, Debug)]
pub struct Message {
    /// The robot that sent the message.
    pub sender: Name,
    /// The one robot that the message was sent to. `None` if it was published to all robots.
    pub recipient: Option<Name>,
    /// The topic of the message.
    pub topic: Topic,
    /// The bytes of the message with their encoding, decoded unless there is a [`problem`](Self::problem).
    pub payload: Payload,
    /// The urgency with which the message was sent.
    pub urgency: Urgency,
    /// The time of sending by the sender's clock, in milliseconds since 1970. `None` if the sender does not use RECT.
    /// The clock of a robot without a real-time clock may be years off.
    pub sent_ms: Option<u64>,
    /// The sequence number of the message at its publisher. `None` if the sender does not use RECT.
    pub sequence: Option<u32>,
    /// The number of messages that the publisher sent directly before this one and that did not arrive.
    pub missed: u32,
    /// Whether a message that was published later arrived before this one.
    pub late: bool,
    /// Why the payload could not be decoded and is delivered as it arrived: it is damaged, too large, or needs an
    /// unknown dictionary. `None` if it was decoded.
    pub problem: Option<CodecError>,
    /// The method by which the message arrived, such as `ble`. `None` if it is unknown, or if this robot has links of
    /// several methods with the sender.
    pub method: Option<String>,
}

/// A sample that Zenoh delivered to a subscription.
#[derive(Clone, Debug)]
pub struct Delivery<'a> {
    /// The Zenoh key.
    pub key: &'a str,
    /// The bytes and their encoding.
    pub payload: Payload,
    /// The attachment, if the sample has one.
    pub attachment: Option<&'a [u8]>,
    /// Zenoh's priority, 1 to 7.
    pub priority: u8,
    /// Whether it arrived through the subscription to messages for this robot alone, rather than the one to published
    /// messages.
    pub directed: bool,
}

/// Turns the samples of one subscription into messages, and counts those that did not arrive.
#[derive(Debug)]
pub struct Inbound {
    keys: KeySpace,
    gaps: Gaps,
}

impl Inbound {
    /// Creates the state of a new subscription by a program of the robot of `keys`.
    pub fn new(keys: KeySpace) -> Self {
        let gaps = Gaps::default();
        Self { keys, gaps }
    }

    /// Returns the message that a sample contains.
    ///
    /// # Errors
    /// Returns an [`AddressError`] if the key is not that of a message to this robot, or if the pattern's other
    /// subscription delivers the same sample.
    pub fn on_delivery(&mut self, delivered: Delivery<'_>) -> Result<Message, AddressError> {
        let address = match self.keys.parse(delivered.key) {
            Ok(address) if address.recipient.is_some() == delivered.directed => address,
            Err(AddressError::InvalidTopic { directed }) if directed == delivered.directed => {
                return Err(AddressError::InvalidTopic { directed });
            }
            _ => return Err(AddressError::NotForThisRobot),
        };
        let attachment = delivered.attachment.and_then(Attachment::decode);
        let mut message = Message {
            sender: address.sender,
            recipient: address.recipient,
            topic: address.topic,
            payload: delivered.payload,
            urgency: Urgency::from_priority(delivered.priority),
            sent_ms: None,
            sequence: None,
            missed: 0,
            late: false,
            problem: None,
            method: None,
        };
        match attachment {
            None => self.gaps.on_unnumbered(&message.sender),
            Some(attachment) => {
                let Attachment {
                    source, sequence, ..
                } = attachment;
                let gap = self.gaps.on_message(&message.sender, source, sequence);
                message.sequence = Some(sequence);
                (message.missed, message.late) = (gap.missed, gap.late);
                if let Sent::At(at_ms) = attachment.sent {
                    message.sent_ms = Some(at_ms);
                }
            }
        }
        Ok(message)
    }

    /// Returns how many messages of each robot were received and missed.
    pub fn counts_by_sender(&self) -> impl Iterator<Item = (&Name, SenderCounts)> {
        self.gaps.counts_by_sender()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::encoding::Encoding;

    fn inbound() -> Inbound {
        let name = |text| Name::new(text).expect("valid name");
        let (fleet, robot) = (name("rect"), name("wombat-1"));
        Inbound::new(KeySpace { fleet, robot })
    }

    fn delivered<'a>(key: &'a str, attachment: Option<&'a [u8]>) -> Delivery<'a> {
        Delivery {
            key,
            payload: Payload::new("1", Encoding::JSON),
            attachment,
            priority: 5,
            directed: key.contains("/to/"),
        }
    }

    #[test]
    fn reads_sender_time_and_sequence_number() {
        let attachment = |sequence| {
            let sent = Sent::At(1_795_000_000_000);
            let source = 7;
            Attachment {
                source,
                sequence,
                sent,
            }
            .encode()
        };
        let mut inbound = inbound();
        let first = inbound.on_delivery(delivered("rect/a/x/y", Some(&attachment(3))));
        let first = first.expect("a message");
        assert_eq!((first.sender.as_str(), first.topic.as_str()), ("a", "x/y"));
        assert_eq!((first.sequence, first.missed), (Some(3), 0));
        assert_eq!(first.sent_ms, Some(1_795_000_000_000));
        let next = inbound.on_delivery(delivered("rect/a/x/y", Some(&attachment(6))));
        assert_eq!(next.expect("a message").missed, 2);
    }

    #[test]
    fn messages_of_other_zenoh_programs_have_no_sequence_number() {
        let mut inbound = inbound();
        for attachment in [None, Some(b"mine".as_slice())] {
            let message = inbound.on_delivery(delivered("rect/a/to/wombat-1/x", attachment));
            let message = message.expect("a message");
            assert_eq!((message.sequence, message.sent_ms), (None, None));
            assert_eq!(message.recipient.expect("to me"), "wombat-1");
        }
        let counts: Vec<_> = inbound.counts_by_sender().collect();
        assert_eq!(counts[0].1.received, 2);
    }

    #[test]
    fn delivers_a_message_once_if_both_subscriptions_match() {
        let mut twice = delivered("rect/a/to/wombat-1/x", None);
        twice.directed = false;
        assert!(inbound().on_delivery(twice).is_err());
    }

    #[test]
    fn counts_an_invalid_topic_once() {
        let topic = "a\u{1b}]0;pwned\u{7}\u{1b}[2Jb\nfake/c";
        for (key, directed) in [
            (format!("rect/a/{topic}"), false),
            (format!("rect/a/to/wombat-1/{topic}"), true),
        ] {
            let mut inbound = inbound();
            let rejected = AddressError::InvalidTopic { directed };
            let first = inbound.on_delivery(delivered(&key, None));
            assert_eq!(first.expect_err("rejected"), rejected);
            let mut twice = delivered(&key, None);
            twice.directed = !directed;
            let second = inbound.on_delivery(twice);
            assert_eq!(second.expect_err("rejected"), AddressError::NotForThisRobot);
            assert_eq!(inbound.counts_by_sender().count(), 0);
        }
    }
}
