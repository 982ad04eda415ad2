//! Owns messages as a program gets them, and [`Inbound`], which makes them of what Zenoh delivers.
use super::{
    attachment::{Attachment, Sent},
    codec::CodecError,
    gaps::{Gaps, Tally},
    key::{NoMessage, Place},
    name::Name,
    payload::Payload,
    topic::Topic,
    urgency::Urgency,
};

/// A message from another robot (or another program of this one).
#[derive(Clone, Debug)]
pub struct Message {
    /// Who sent it.
    pub from: Name,
    /// To whom alone; `None`: to all.
    pub to: Option<Name>,
    /// About what.
    pub topic: Topic,
    /// What it says.
    pub payload: Payload,
    /// How urgent.
    pub urgency: Urgency,
    /// When, by the sender's clock, in milliseconds since 1970; `None` for one of a stock program. A robot without a clock
    /// of its own may be years off.
    pub sent_ms: Option<u64>,
    /// Its number at its publisher; `None` for one of a stock program.
    pub sequence: Option<u32>,
    /// So many of its publisher, before it, did not arrive.
    pub missed: u32,
    /// It was overtaken on its way.
    pub late: bool,
    /// Why it is still packed as it came, if it is: it is damaged, or of a codec that is not known here.
    pub flaw: Option<CodecError>,
    /// By what it came, as `ble`, where its sender has one link with this robot, and that is known.
    pub over: Option<String>,
}

/// What Zenoh delivered.
#[derive(Clone, Debug)]
pub struct Delivered<'a> {
    /// Its key.
    pub key: &'a str,
    /// Bytes and encoding.
    pub payload: Payload,
    /// What goes with it.
    pub attachment: Option<&'a [u8]>,
    /// Zenoh's priority, 1 to 7.
    pub priority: u8,
    /// Whether it came by the subscription of what is for this robot alone.
    pub directed: bool,
}

/// Makes messages of what Zenoh delivers to one subscription.
#[derive(Debug)]
pub struct Inbound {
    place: Place,
    gaps: Gaps,
}

impl Inbound {
    /// For a program of that robot.
    pub fn new(place: Place) -> Self {
        let gaps = Gaps::default();
        Self { place, gaps }
    }

    /// Makes the message.
    ///
    /// # Errors
    /// [`NoMessage`]: it is not a message to this robot, or the other one of a pattern's two subscriptions delivers it too.
    pub fn on_delivered(&mut self, delivered: Delivered<'_>) -> Result<Message, NoMessage> {
        let address = match self.place.read(delivered.key) {
            Ok(address) if address.to.is_some() == delivered.directed => address,
            Err(NoMessage::InvalidTopic { directed }) if directed == delivered.directed => {
                return Err(NoMessage::InvalidTopic { directed });
            }
            _ => return Err(NoMessage::Elsewhere),
        };
        let attachment = delivered.attachment.and_then(Attachment::decode);
        let mut message = Message {
            from: address.from,
            to: address.to,
            topic: address.topic,
            payload: delivered.payload,
            urgency: Urgency::of(delivered.priority),
            sent_ms: None,
            sequence: None,
            missed: 0,
            late: false,
            flaw: None,
            over: None,
        };
        match attachment {
            None => self.gaps.on_unnumbered(&message.from),
            Some(attachment) => {
                let Attachment {
                    source, sequence, ..
                } = attachment;
                let gap = self.gaps.on_message(&message.from, source, sequence);
                message.sequence = Some(sequence);
                (message.missed, message.late) = (gap.missed, gap.late);
                if let Sent::At(at_ms) = attachment.sent {
                    message.sent_ms = Some(at_ms);
                }
            }
        }
        Ok(message)
    }

    /// What arrived of each robot.
    pub fn tallies(&self) -> impl Iterator<Item = (&Name, Tally)> {
        self.gaps.tallies()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::encoding::Encoding;

    fn inbound() -> Inbound {
        let name = |text| Name::new(text).expect("a name");
        let (fleet, robot) = (name("rect"), name("wombat-1"));
        Inbound::new(Place { fleet, robot })
    }

    fn delivered<'a>(key: &'a str, attachment: Option<&'a [u8]>) -> Delivered<'a> {
        Delivered {
            key,
            payload: Payload::new("1", Encoding::JSON),
            attachment,
            priority: 5,
            directed: key.contains("/to/"),
        }
    }

    #[test]
    fn a_message_says_who_when_and_which() {
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
        let first = inbound.on_delivered(delivered("rect/a/x/y", Some(&attachment(3))));
        let first = first.expect("a message");
        assert_eq!((first.from.as_str(), first.topic.as_str()), ("a", "x/y"));
        assert_eq!((first.sequence, first.missed), (Some(3), 0));
        assert_eq!(first.sent_ms, Some(1_795_000_000_000));
        let next = inbound.on_delivered(delivered("rect/a/x/y", Some(&attachment(6))));
        assert_eq!(next.expect("a message").missed, 2);
    }

    #[test]
    fn a_stock_programs_message_is_one_without_a_number() {
        let mut inbound = inbound();
        for attachment in [None, Some(b"mine".as_slice())] {
            let message = inbound.on_delivered(delivered("rect/a/to/wombat-1/x", attachment));
            let message = message.expect("a message");
            assert_eq!((message.sequence, message.sent_ms), (None, None));
            assert_eq!(message.to.expect("to me"), "wombat-1");
        }
        let tallies: Vec<_> = inbound.tallies().collect();
        assert_eq!(tallies[0].1.received, 2);
    }

    #[test]
    fn what_both_subscriptions_bring_comes_once() {
        let mut twice = delivered("rect/a/to/wombat-1/x", None);
        twice.directed = false;
        assert!(inbound().on_delivered(twice).is_err());
    }

    #[test]
    fn an_invalid_topic_of_another_program_is_rejected_once() {
        let topic = "a\u{1b}]0;pwned\u{7}\u{1b}[2Jb\nfake/c";
        for (key, directed) in [
            (format!("rect/a/{topic}"), false),
            (format!("rect/a/to/wombat-1/{topic}"), true),
        ] {
            let mut inbound = inbound();
            let rejected = NoMessage::InvalidTopic { directed };
            let first = inbound.on_delivered(delivered(&key, None));
            assert_eq!(first.expect_err("rejected"), rejected);
            let mut twice = delivered(&key, None);
            twice.directed = !directed;
            let second = inbound.on_delivered(twice);
            assert_eq!(second.expect_err("rejected"), NoMessage::Elsewhere);
            assert_eq!(inbound.tallies().count(), 0);
        }
    }
}
