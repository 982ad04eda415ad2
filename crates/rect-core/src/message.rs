//! Defines [`Message`], and [`Inbound`], which turns Zenoh samples into messages.
pub mod attachment;
pub(crate) mod codec_error;
pub mod counters;
pub mod encoding;
pub mod expiry;
pub mod gaps;
mod leb128;
pub mod mismatch;
pub mod payload;
pub mod problems;
pub mod queue;
pub mod request;
pub mod retained;
pub mod sequence;
pub mod throttled;
pub mod urgency;

use std::time::{Duration, Instant, SystemTime};

use zenoh_keyexpr::keyexpr;

use self::{
    attachment::{Attachment, Sent},
    encoding::Encoding,
    gaps::{Gaps, SenderCounts},
    payload::{FromPayload, Payload, PayloadError},
    retained::{live::Live, order::RetainedOrder, Arrival, Following, Retained},
    throttled::{header::Header, receiver::Receiver, Wish},
    urgency::Urgency,
};
use crate::name::{
    key::{Address, AddressError, Audience, KeySpace, Selected},
    topic::{Pattern, Topic},
    Name,
};

/// A message from another robot, or from another program of this robot. `T` is the type that the program has stated for
/// its value.
#[derive(Clone, Debug)]
pub struct Message<T = ()> {
    /// The robot that sent the message.
    pub sender: Name,
    /// The one robot that the message was sent to. `None` if it was published to all robots.
    pub recipient: Option<Name>,
    /// The topic of the message.
    pub topic: Topic,
    /// The bytes of the message with their encoding, decoded unless there is a [`problem`](Self::problem) with that.
    pub payload: Payload,
    /// The urgency with which the message was sent.
    pub urgency: Urgency,
    /// The time of sending by the sender's clock, to the millisecond. `None` if the sender does not use RECT. The clock of a
    /// robot without a real-time clock may be years off.
    pub sent_at: Option<SystemTime>,
    /// The sequence number of the message at its publisher. `None` if the sender does not use RECT.
    pub sequence: Option<u32>,
    /// A random number that identifies the publisher: two programs of a robot may publish the same topic. `None` if the sender
    /// does not use RECT.
    pub publisher: Option<u16>,
    /// The number of messages that the publisher sent directly before this one and that did not arrive.
    pub missed: u32,
    /// The number of messages that the publisher sent directly before this one and that were left out because the subscription asked for
    /// fewer ([`Wish`]).
    pub skipped: u32,
    /// Whether a message that was published later arrived before this one.
    pub late: bool,
    /// Whether the message repeats one of a recording. [`sent_at`](Self::sent_at) is the time of that one.
    pub replayed: bool,
    /// When the message expires, on this computer's clock. `None`: it never does. A program that is busy for long may look again
    /// before it acts on the message.
    pub expires_at: Option<Instant>,
    /// The value as the type that the program has stated, or the problem why there is none. [`PayloadError::Codec`]: the payload
    /// could not be decoded and is delivered as it arrived, because it is damaged, too large, or needs an unknown dictionary.
    /// [`PayloadError::Type`] and others: the value does not fit the type.
    pub value: Result<T, PayloadError>,
    /// The method by which the message arrived, such as `ble`. `None` if it is unknown, or if this robot has links of
    /// several methods with the sender.
    pub method: Option<String>,
    /// That the topic is retained, and how old this value of it is. `None`: the message is not of a retained topic.
    pub retained: Option<Retained>,
}

impl Message {
    /// Creates a message that was published to all robots, by a sender that does not use RECT.
    pub fn new(sender: Name, topic: Topic, payload: Payload) -> Self {
        Self {
            sender,
            recipient: None,
            topic,
            payload,
            urgency: Urgency::default(),
            sent_at: None,
            sequence: None,
            publisher: None,
            missed: 0,
            skipped: 0,
            late: false,
            replayed: false,
            expires_at: None,
            value: Ok(()),
            method: None,
            retained: None,
        }
    }

    /// Returns the message with its value as the type that the program has stated.
    pub fn typed<T: FromPayload>(self) -> Message<T::Value> {
        Message {
            value: self.value.and_then(|()| T::from_payload(&self.payload)),
            sender: self.sender,
            recipient: self.recipient,
            topic: self.topic,
            payload: self.payload,
            urgency: self.urgency,
            sent_at: self.sent_at,
            sequence: self.sequence,
            publisher: self.publisher,
            missed: self.missed,
            skipped: self.skipped,
            late: self.late,
            replayed: self.replayed,
            expires_at: self.expires_at,
            method: self.method,
            retained: self.retained,
        }
    }
}

impl Message {
    /// Sets what its publisher says about it. It has been on the way for `age`. `now` is only needed if it expires.
    ///
    /// # Errors
    /// [`Undelivered::Expired`] if it has.
    fn describe(
        &mut self,
        attachment: &Attachment,
        age: Duration,
        now: Option<Instant>,
    ) -> Result<(), Undelivered> {
        self.sequence = Some(attachment.sequence);
        self.publisher = Some(attachment.source);
        self.sent_at = attachment.sent.at();
        self.replayed = attachment.sent.is_replayed();
        let Some((ms, now)) = attachment.lifetime_ms.zip(now) else {
            return Ok(());
        };
        let rest = Duration::from_millis(ms.into()).checked_sub(age);
        let missed = self.missed;
        let rest = rest.filter(|rest| !rest.is_zero());
        self.expires_at = Some(now + rest.ok_or(Undelivered::Expired { missed })?);
        Ok(())
    }
}

impl<T> Message<T> {
    /// Returns why the message has no value, if it has none.
    pub fn problem(&self) -> Option<&PayloadError> {
        self.value.as_ref().err()
    }

    /// Returns whether the robot has forgotten the retained topic, so that the message has no value.
    pub fn is_forgotten(&self) -> bool {
        self.retained.is_some_and(|retained| retained.is_forgotten)
    }

    /// Returns whether the message has expired at that time.
    pub fn is_expired(&self, now: Instant) -> bool {
        self.expires_at.is_some_and(|at| at <= now)
    }
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
    /// Whether the key was deleted.
    pub is_deleted: bool,
    /// The number of the subscription through which it arrived, among those of [`Inbound::new`].
    pub subscription: usize,
}

/// Why a sample is not delivered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Undelivered {
    /// Its key is not that of a message that is selected, or another subscription delivers it.
    NotSelected,
    /// The key is that of a message except for its topic, which RECT does not allow.
    InvalidTopic,
    /// The message has expired.
    Expired {
        /// The number of messages directly before it that did not arrive.
        missed: u32,
    },
}

/// Turns the samples of several Zenoh subscriptions into messages, each once, and counts those that did not arrive.
#[derive(Debug)]
pub struct Inbound {
    keys: KeySpace,
    selected: Vec<Selected>,
    gaps: Gaps,
    /// The key of the last message, its parts, and the subscription that delivers it: most subscriptions receive few keys.
    last: Option<(String, Address, usize)>,
    /// Whether retained messages come from the router.
    following: Following,
    retained: RetainedOrder,
    throttled: Option<Throttled>,
}

/// A subscription that wants fewer messages than are published.
#[derive(Debug)]
struct Throttled {
    /// The key expression of its messages.
    key: String,
    /// The key of the token by which it asks for them.
    token: String,
    receiver: Receiver,
}

impl Inbound {
    /// Creates the state of new subscriptions by a program of the robot of `keys`.
    pub fn new(keys: KeySpace, selected: impl Into<Vec<Selected>>, now: Instant) -> Self {
        Self {
            keys,
            selected: selected.into(),
            gaps: Gaps::new(now),
            last: None,
            following: Following::default(),
            retained: RetainedOrder::default(),
            throttled: None,
        }
    }

    /// Creates the state of the subscriptions of a pattern. `wish`: to fewer messages than are published to all robots.
    pub fn of_pattern(keys: KeySpace, pattern: &Pattern, wish: Option<Wish>, now: Instant) -> Self {
        let throttled = wish.map(|wish| Throttled {
            key: throttled::subscription(&keys, pattern),
            token: throttled::token(&keys, wish, pattern),
            receiver: Receiver::new(wish),
        });
        let selected = keys.subscriptions(pattern);
        Self {
            throttled,
            ..Self::new(keys, selected, now)
        }
    }

    /// Delivers retained messages as they are published if they do not come from the router, as `following` says.
    pub fn follow(&mut self, following: Following) {
        self.following = following;
    }

    /// Returns the messages of retained values from the router that one of the subscriptions selects, and that were not delivered before.
    pub fn on_retained(&mut self, arrival: &Arrival) -> Vec<Message> {
        match arrival {
            Arrival::Value { value, router } => {
                let Some(robot) = value.robot.clone() else {
                    return Vec::new();
                };
                let is_new =
                    self.selects(&robot, &value.topic) && self.retained.on_value(value, *router);
                is_new.then(|| value.message(robot)).into_iter().collect()
            }
            Arrival::Complete { robot, at, router } => {
                let topics = self.retained.on_complete(robot, *at, *router);
                let forgotten = topics.into_iter().map(|topic| Message {
                    value: Err(PayloadError::Forgotten),
                    retained: Some(Retained {
                        is_forgotten: true,
                        ..Retained::default()
                    }),
                    ..Message::new(robot.clone(), topic, Payload::new("", Encoding::BYTES))
                });
                forgotten.collect()
            }
        }
    }

    /// Returns whether a subscription selects a topic of a robot that is published to all.
    fn selects(&self, robot: &Name, topic: &Topic) -> bool {
        let key = self.keys.service(Some(robot), topic);
        let Ok(key) = keyexpr::new(&key) else {
            return false;
        };
        let all = (self.selected.iter()).filter(|selected| selected.audience == Audience::All);
        let mut keys = all.filter_map(|selected| keyexpr::new(&selected.key).ok());
        keys.any(|selected| selected.intersects(key))
    }

    /// Returns the message that a sample contains. `now` is only called if the message expires.
    ///
    /// # Errors
    /// Returns why the sample is not delivered.
    pub fn on_delivery(
        &mut self,
        delivered: Delivery<'_>,
        now: impl FnOnce() -> Instant,
    ) -> Result<Message, Undelivered> {
        if self.is_throttled(delivered.subscription) {
            return self.on_throttled(delivered, now());
        }
        let address = self.parse(delivered.key, delivered.subscription)?;
        let live = delivered.attachment.and_then(Live::decode);
        if let Some(live) = live.filter(|_| self.following.is_active()) {
            let (robot, topic) = (&address.sender, &address.topic);
            if !(self.retained).on_live(robot, topic, live, delivered.is_deleted) {
                return Err(Undelivered::NotSelected);
            }
        }
        let attachment = delivered.attachment.and_then(Attachment::decode);
        let mut message = Message {
            recipient: address.recipient,
            urgency: Urgency::from_priority(delivered.priority),
            ..Message::new(address.sender, address.topic, delivered.payload)
        };
        match attachment {
            None => {
                self.gaps.on_unnumbered(&message.sender);
                if let Some(live) = live {
                    (message.sent_at, message.replayed) = (live.sent.at(), live.sent.is_replayed());
                    message.retained = Some(Retained {
                        is_forgotten: delivered.is_deleted,
                        ..Retained::default()
                    });
                    if delivered.is_deleted {
                        message.value = Err(PayloadError::Forgotten);
                    }
                }
            }
            Some(attachment) => {
                let now = attachment.lifetime_ms.map(|_| now());
                let arrival = (self.gaps).on_message(&message.sender, &attachment, now);
                (message.missed, message.late) = (arrival.missed, arrival.late);
                message.describe(&attachment, arrival.age, now)?;
            }
        }
        Ok(message)
    }

    /// Returns the message of a throttled subscription that a sample contains.
    fn on_throttled(
        &mut self,
        delivered: Delivery<'_>,
        now: Instant,
    ) -> Result<Message, Undelivered> {
        let throttled = self.throttled.as_mut().ok_or(Undelivered::NotSelected)?;
        let (sender, topic) =
            throttled::of_message(&self.keys, delivered.key).ok_or(Undelivered::NotSelected)?;
        let (header, attachment) = (delivered.attachment)
            .and_then(Header::decode)
            .ok_or(Undelivered::NotSelected)?;
        let attachment = Attachment::decode(attachment);
        let stream = throttled.receiver.stream(&sender, &topic, header, now);
        let place = stream.place(header);
        // The numbers of the stream show what was lost on the way: those of the publisher also have gaps where messages were left out.
        let numbered = Attachment {
            source: place.source,
            sequence: place.number,
            sent: attachment.map_or(Sent::Unknown, |attachment| attachment.sent),
            lifetime_ms: None,
        };
        let expires = attachment.and_then(|attachment| attachment.lifetime_ms);
        let at = expires.map(|_| now);
        let arrival = self.gaps.on_message(&sender, &numbered, at);
        let gap = stream.on_message(header, attachment, arrival.missed, now);
        let gap = gap.ok_or(Undelivered::NotSelected)?;
        let mut message = Message {
            urgency: Urgency::from_priority(delivered.priority),
            missed: gap.missed,
            skipped: gap.skipped,
            late: arrival.late,
            ..Message::new(sender, topic, delivered.payload)
        };
        if let Some(attachment) = attachment {
            message.describe(&attachment, arrival.age, at)?;
        }
        Ok(message)
    }

    /// Returns the subscriptions that select the messages.
    pub fn selected(&self) -> &[Selected] {
        &self.selected
    }

    /// Returns the key expressions to subscribe to.
    pub fn keys(&self) -> Vec<String> {
        let selected = self.selected.iter().enumerate();
        let key = |(at, selected): (usize, &Selected)| match &self.throttled {
            Some(throttled) if self.is_throttled(at) => throttled.key.clone(),
            _ => selected.key.clone(),
        };
        selected.map(key).collect()
    }

    /// Returns whether the messages of that subscription are throttled: those that are published to all robots.
    fn is_throttled(&self, subscription: usize) -> bool {
        let selected = self.selected.get(subscription);
        self.throttled.is_some() && selected.is_some_and(|one| one.audience == Audience::All)
    }

    /// Returns the key of the token by which a throttled subscription asks for messages.
    pub fn token(&self) -> Option<&str> {
        let throttled = self.throttled.as_ref()?;
        Some(&throttled.token)
    }

    fn parse(&mut self, key: &str, subscription: usize) -> Result<Address, Undelivered> {
        let (address, delivers) = match &self.last {
            Some((last, address, delivers)) if last == key => (Ok(address.clone()), *delivers),
            _ => {
                let address = self.keys.parse(key);
                let recipient = match &address {
                    Ok(address) => address.recipient.as_ref(),
                    Err(AddressError::InvalidTopic { recipient }) => recipient.as_ref(),
                    Err(AddressError::NotAMessage) => return Err(Undelivered::NotSelected),
                };
                let delivers = self.delivers(key, self.keys.audience(recipient));
                let delivers = delivers.ok_or(Undelivered::NotSelected)?;
                if let Ok(address) = &address {
                    self.last = Some((key.to_owned(), address.clone(), delivers));
                }
                (address, delivers)
            }
        };
        if delivers != subscription {
            return Err(Undelivered::NotSelected);
        }
        address.map_err(|_| Undelivered::InvalidTopic)
    }

    /// Returns the first of the subscriptions that select a message of that key to that audience.
    fn delivers(&self, key: &str, audience: Audience) -> Option<usize> {
        let numbered = self.selected.iter().enumerate();
        let mut alike = numbered.filter(|(_, selected)| selected.audience == audience);
        let (first, _) = alike.next()?;
        if alike.next().is_none() {
            return Some(first);
        }
        let key = keyexpr::new(key).ok()?;
        self.selected.iter().position(|selected| {
            let matches = keyexpr::new(&selected.key).is_ok_and(|selected| selected.includes(key));
            selected.audience == audience && matches
        })
    }

    /// Returns how many messages of each robot were received and missed.
    pub fn counts_by_sender(&self) -> impl Iterator<Item = (&Name, SenderCounts)> {
        self.gaps.counts_by_sender()
    }
}

#[cfg(test)]
mod tests {
    use std::time::UNIX_EPOCH;

    use super::*;
    use crate::{
        message::{attachment::Sent, encoding::Encoding},
        name::topic::Pattern,
    };

    fn inbound() -> Inbound {
        let name = |text| Name::new(text).expect("valid name");
        let (fleet, robot) = (name("rect"), name("wombat-1"));
        let keys = KeySpace { fleet, robot };
        let selected = keys.subscriptions(&Pattern::new("*/**").expect("valid pattern"));
        Inbound::new(keys, selected, Instant::now())
    }

    const PUBLISHED: usize = 0;
    const TO_THIS_ROBOT: usize = 1;

    fn delivered<'a>(key: &'a str, attachment: Option<&'a [u8]>) -> Delivery<'a> {
        Delivery {
            key,
            payload: Payload::new("1", Encoding::JSON),
            attachment,
            priority: 5,
            is_deleted: false,
            subscription: usize::from(key.contains("/to/")),
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
                lifetime_ms: None,
            }
            .encode()
        };
        let mut inbound = inbound();
        let first =
            inbound.on_delivery(delivered("rect/a/x/y", Some(&attachment(3))), Instant::now);
        let first = first.expect("a message");
        assert_eq!((first.sender.as_str(), first.topic.as_str()), ("a", "x/y"));
        assert_eq!((first.sequence, first.missed), (Some(3), 0));
        assert_eq!(
            first.sent_at,
            Some(UNIX_EPOCH + Duration::from_millis(1_795_000_000_000))
        );
        assert!(!first.replayed);
        let next = inbound.on_delivery(delivered("rect/a/x/y", Some(&attachment(6))), Instant::now);
        assert_eq!(next.expect("a message").missed, 2);
    }

    #[test]
    fn message_of_a_recording_has_the_time_of_that_one() {
        let attachment = Attachment {
            source: 7,
            sequence: 0,
            sent: Sent::Replayed(5000),
            lifetime_ms: None,
        };
        let attachment = attachment.encode();
        let delivered = delivered("rect/a/x", Some(&attachment));
        let message = inbound().on_delivery(delivered, Instant::now);
        let message = message.expect("a message");
        assert_eq!(
            (message.sent_at, message.replayed),
            (Some(UNIX_EPOCH + Duration::from_millis(5000)), true)
        );
    }

    #[test]
    fn message_that_was_held_up_is_not_delivered() {
        let (mut inbound, start) = (inbound(), Instant::now());
        let ms = Duration::from_millis;
        let mut on_message = |sequence: u32, sent: u64, arrived: u64| {
            let attachment = Attachment {
                source: 7,
                sequence,
                sent: Sent::At(1_795_000_000_000 + sent),
                lifetime_ms: Some(200),
            };
            let attachment = attachment.encode();
            let delivered = delivered("rect/a/drive", Some(&attachment));
            inbound.on_delivery(delivered, || start + ms(arrived))
        };
        let fresh = on_message(0, 0, 10).expect("delivered");
        assert!(!fresh.is_expired(start + ms(209)));
        assert!(fresh.is_expired(start + ms(210)), "in the receive queue");
        let late = on_message(1, 100, 260).expect("delivered");
        assert!(!late.is_expired(start + ms(309)));
        assert!(late.is_expired(start + ms(310)), "150 ms on the way");
        let expired = on_message(4, 300, 3300).expect_err("3 s on the way");
        assert_eq!(expired, Undelivered::Expired { missed: 2 });
        assert!(on_message(5, 3290, 3300).is_ok());
    }

    /// Another program of the robot may send anything in the name of a publisher, by mistake or not: in the year 2286, or a second
    /// ahead, and with any number.
    #[test]
    fn one_wrong_attachment_does_not_make_messages_expire() {
        const SENT_MS: u64 = 1_795_000_000_000;
        const IN_2286_MS: u64 = 9_999_999_999_999;
        let (start, ms) = (Instant::now(), Duration::from_millis);
        for period in [20, 100, 1000] {
            for sequence in [0, 9, 10, 11, 500, 1 << 20, (1 << 30) + 7, 1 << 31, u32::MAX] {
                for wrong_ms in [IN_2286_MS, SENT_MS + 10 * period + 900, SENT_MS + 90, 0] {
                    let mut inbound = inbound();
                    let mut on_message = |sequence, sent_ms, arrived: u64| {
                        let attachment = Attachment {
                            source: 7,
                            sequence,
                            sent: Sent::At(sent_ms),
                            lifetime_ms: Some(200),
                        };
                        let attachment = attachment.encode();
                        let delivered = delivered("rect/a/drive", Some(&attachment));
                        inbound.on_delivery(delivered, || start + ms(arrived))
                    };
                    let mut expired = 0;
                    for n in 0..700 {
                        let at = u64::from(n) * period;
                        let message = on_message(n, SENT_MS + at, at + 20);
                        expired += u32::from(message.is_err());
                        if n == 10 {
                            drop(on_message(sequence, wrong_ms, at + 30));
                        }
                    }
                    let case = format!("every {period} ms, number {sequence}, sent at {wrong_ms}");
                    assert_eq!(expired, 0, "{case}");
                    // The lifetime still counts.
                    let held_up = on_message(700, SENT_MS + 700 * period, 700 * period + 5000);
                    assert!(held_up.is_err(), "{case}");
                }
            }
        }
    }

    #[test]
    fn messages_of_other_zenoh_programs_have_no_sequence_number() {
        let mut inbound = inbound();
        for attachment in [None, Some(b"mine".as_slice())] {
            let message =
                inbound.on_delivery(delivered("rect/a/to/wombat-1/x", attachment), Instant::now);
            let message = message.expect("a message");
            assert_eq!((message.sequence, message.sent_at), (None, None));
            assert_eq!(message.recipient.expect("to me"), "wombat-1");
        }
        let counts: Vec<_> = inbound.counts_by_sender().collect();
        assert_eq!(counts[0].1.received, 2);
    }

    #[test]
    fn delivers_a_message_once_if_both_subscriptions_match() {
        let mut twice = delivered("rect/a/to/wombat-1/x", None);
        twice.subscription = PUBLISHED;
        assert!(inbound().on_delivery(twice, Instant::now).is_err());
    }

    #[test]
    fn counts_an_invalid_topic_once() {
        let topic = "a\u{1b}]0;pwned\u{7}\u{1b}[2Jb\nfake/c";
        for (key, other) in [
            (format!("rect/a/{topic}"), TO_THIS_ROBOT),
            (format!("rect/a/to/wombat-1/{topic}"), PUBLISHED),
        ] {
            let mut inbound = inbound();
            let first = inbound.on_delivery(delivered(&key, None), Instant::now);
            assert_eq!(first.expect_err("rejected"), Undelivered::InvalidTopic);
            let mut twice = delivered(&key, None);
            twice.subscription = other;
            let second = inbound.on_delivery(twice, Instant::now);
            assert_eq!(second.expect_err("rejected"), Undelivered::NotSelected);
            assert_eq!(inbound.counts_by_sender().count(), 0);
        }
    }

    #[test]
    fn a_recorder_receives_each_message_once() {
        let name = |text| Name::new(text).expect("valid name");
        let (fleet, robot) = (name("rect"), name("wombat-1"));
        let keys = KeySpace { fleet, robot };
        let delivering = |patterns: &[&str], key: &str| {
            let patterns = patterns.iter().map(|text| Pattern::new(text));
            let patterns: Vec<_> = patterns.map(|new| new.expect("valid pattern")).collect();
            let selected = keys.recorded(&patterns);
            let sample = keyexpr::new(key).expect("a key");
            let mut inbound = Inbound::new(keys.clone(), selected.clone(), Instant::now());
            let matching = selected.iter().enumerate().filter(|(_, selected)| {
                let selected = keyexpr::new(&selected.key).expect("a key expression");
                selected.includes(sample)
            });
            let delivered = matching.filter(|(subscription, _)| {
                let mut delivered = delivered(key, None);
                delivered.subscription = *subscription;
                inbound.on_delivery(delivered, Instant::now).is_ok()
            });
            delivered.count()
        };
        let own = [
            "rect/wombat-1/x/y",
            "rect/wombat-1/to/wombat-2/x",
            "rect/wombat-1/to/wombat-1/x",
            "rect/wombat-2/to/wombat-1/x",
        ];
        let others = ["rect/wombat-2/x", "rect/wombat-2/to/wombat-3/x"];
        for (patterns, key, count) in [
            own.map(|key| (&[][..], key, 1)).as_slice(),
            &others.map(|key| (&[][..], key, 0)),
            &own.map(|key| (&["*/**", "wombat-1/**", "*/x"][..], key, 1)),
            &[(&["*/**"], "rect/wombat-2/x", 1)],
            &[(&["*/**"], "rect/wombat-2/to/wombat-3/x", 0)],
            &[(&["wombat-2/**"], "rect/wombat-1/to/wombat-2/x", 0)],
            &[(&["wombat-1/**"], "rect/wombat-2/to/wombat-1/x", 0)],
        ]
        .concat()
        {
            assert_eq!(delivering(patterns, key), count, "{patterns:?} {key}");
        }
    }
}
