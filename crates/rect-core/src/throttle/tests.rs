//! Runs a throttle and the subscribers of other robots in virtual time.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use zenoh_keyexpr::keyexpr;

use super::*;
use crate::{
    driver::Reaction,
    message::{
        attachment::{Attachment, Sent},
        encoding::Encoding,
        payload::Payload,
        Delivery, Inbound, Message,
    },
    name::topic::Pattern,
};

fn place(robot: &str) -> KeySpace {
    let name = |text| Name::new(text).expect("valid name");
    KeySpace {
        fleet: name("rect"),
        robot: name(robot),
    }
}

/// A subscriber of another robot, with the messages that reached it.
struct Subscriber {
    inbound: Inbound,
    messages: Vec<(Duration, Message)>,
}

/// The robot wombat-1 with its throttle, and subscribers of others.
struct World {
    start: Instant,
    now: Instant,
    throttle: Throttle,
    declared: BTreeMap<Id, Declaration>,
    subscribers: Vec<Subscriber>,
    sequence: u32,
    /// The messages that were sent, by their keys.
    sent: BTreeMap<String, usize>,
    warnings: Vec<String>,
    /// How many of the next messages are lost on the way.
    lost: usize,
}

impl World {
    fn new() -> Self {
        let start = Instant::now();
        let mut world = Self {
            start,
            now: start,
            throttle: Throttle::new(place("wombat-1")),
            declared: BTreeMap::new(),
            subscribers: Vec::new(),
            sequence: 0,
            sent: BTreeMap::new(),
            warnings: Vec::new(),
            lost: 0,
        };
        world.poll();
        world
    }

    fn subscribe(&mut self, robot: &str, pattern: &str, max_hz: Option<f64>, on_change: bool) {
        let wish = crate::message::throttled::Wish::new(max_hz, on_change).expect("valid wish");
        let pattern = Pattern::new(pattern).expect("valid pattern");
        let inbound = Inbound::of_pattern(place(robot), &pattern, wish, self.now);
        self.token(inbound.token().expect("a wish").to_owned(), false);
        self.subscribers.push(Subscriber {
            inbound,
            messages: Vec::new(),
        });
    }

    fn token(&mut self, key: String, is_deleted: bool) {
        let sample = sample(key, Payload::new("", Encoding::BYTES), None, is_deleted);
        self.event(Event::Sample { id: TOKENS, sample });
    }

    fn event(&mut self, event: Event) {
        let Reaction { polls, .. } = self.throttle.on_event(self.now, event);
        if polls {
            self.poll();
        }
    }

    /// Publishes a value on a topic of wombat-1.
    fn publish(&mut self, topic: &str, value: &str) {
        let attachment = Attachment {
            source: 7,
            sequence: self.sequence,
            sent: Sent::Unknown,
            lifetime_ms: None,
        };
        self.sequence += 1;
        let key = format!("rect/wombat-1/{topic}");
        let matching: Vec<_> = (self.declared.iter())
            .filter_map(|(id, declaration)| match declaration {
                Declaration::Subscriber { key: pattern } => {
                    let pattern = keyexpr::new(pattern.as_str()).ok()?;
                    let key = keyexpr::new(key.as_str()).ok()?;
                    pattern.includes(key).then_some(*id)
                }
                _ => None,
            })
            .collect();
        for id in matching {
            let payload = Payload::new(value.to_owned(), Encoding::TEXT);
            let attachment = Some(attachment.encode().to_vec().into());
            let sample = sample(key.clone(), payload, attachment, false);
            self.event(Event::Sample { id, sample });
        }
    }

    /// Lets time pass, and the throttle do what becomes due.
    fn pass(&mut self, time: Duration) {
        let end = self.now + time;
        while let Some(due) = self.poll().filter(|due| *due <= end) {
            self.now = due.max(self.now);
        }
        self.now = end;
    }

    fn poll(&mut self) -> Option<Instant> {
        loop {
            match self.throttle.poll(self.now) {
                Step::Act(Action::Declare { id, declaration }) => {
                    self.declared.insert(id, declaration);
                }
                Step::Act(Action::Undeclare { id }) => {
                    self.declared.remove(&id).expect("it is declared");
                }
                Step::Act(Action::Put {
                    publisher,
                    payload,
                    attachment,
                }) => self.deliver(publisher, &payload, &attachment.expect("a header")),
                Step::Act(action) => panic!("{action:?}"),
                Step::Deliver(warning) => self.warnings.push(warning),
                Step::Wait(until) => return until,
                Step::Finished(()) => return None,
            }
        }
    }

    fn deliver(&mut self, publisher: Id, payload: &Payload, attachment: &[u8]) {
        let Some(Declaration::Publisher { key, .. }) = self.declared.get(&publisher) else {
            panic!("no publisher");
        };
        *self.sent.entry(key.clone()).or_default() += 1;
        if self.lost > 0 {
            self.lost -= 1;
            return;
        }
        for subscriber in &mut self.subscribers {
            let pattern = subscriber.inbound.keys().remove(0);
            let pattern = keyexpr::new(pattern.as_str()).expect("a key expression");
            if !keyexpr::new(key.as_str()).is_ok_and(|key| pattern.includes(key)) {
                continue;
            }
            let delivery = Delivery {
                key,
                payload: payload.clone(),
                attachment: Some(attachment),
                priority: 5,
                is_deleted: false,
                subscription: 0,
            };
            let now = self.now;
            if let Ok(message) = subscriber.inbound.on_delivery(delivery, || now) {
                subscriber.messages.push((self.now - self.start, message));
            }
        }
    }

    /// Returns what a subscriber has received: when, in milliseconds, and the value.
    fn received(&self, subscriber: usize) -> Vec<(u128, String)> {
        let messages = self.subscribers[subscriber].messages.iter();
        let received = messages.map(|(at, message)| {
            let value = String::from_utf8_lossy(&message.payload.bytes);
            (at.as_millis(), value.into_owned())
        });
        received.collect()
    }

    fn values(&self, subscriber: usize) -> Vec<String> {
        let received = self.received(subscriber).into_iter();
        received.map(|(_, value)| value).collect()
    }

    /// Returns a subscriber of the throttle.
    fn subscriber(&self) -> Id {
        let mut declared = self.declared.iter();
        let found =
            declared.find(|(_, declaration)| matches!(declaration, Declaration::Subscriber { .. }));
        *found.expect("it subscribes").0
    }

    fn sent_to(&self, robot: &str, topic: &str) -> usize {
        let key = format!("rect/wombat-1/@rect/throttled/{robot}/{topic}");
        self.sent.get(&key).copied().unwrap_or_default()
    }

    /// Publishes `count` numbers at a rate.
    fn publish_at(&mut self, hz: u32, topic: &str, count: usize) {
        for number in 0..count {
            self.publish(topic, &number.to_string());
            self.pass(Duration::from_secs(1) / hz);
        }
    }
}

fn sample(
    key: String,
    payload: Payload,
    attachment: Option<bytes::Bytes>,
    is_deleted: bool,
) -> Sample {
    Sample {
        key,
        payload,
        attachment,
        is_deleted,
        priority: Sample::PRIORITY,
    }
}

#[test]
fn newest_value_wins_and_nothing_counts_as_missed() {
    let mut world = World::new();
    world.subscribe("laptop", "wombat-1/pose", Some(2.0), false);
    world.publish_at(20, "pose", 100);
    world.pass(Duration::from_secs(5));
    let received = world.received(0);
    assert!((10..=11).contains(&received.len()), "{received:?}");
    assert_eq!(received.first(), Some(&(0, "0".to_owned())));
    assert_eq!(received.last().map(|(_, value)| value.as_str()), Some("99"));
    assert_eq!(world.sent_to("laptop", "pose"), received.len());
    let messages = &world.subscribers[0].messages;
    assert!(messages.iter().all(|(_, message)| message.missed == 0));
    let skipped: u32 = messages.iter().map(|(_, message)| message.skipped).sum();
    assert_eq!(skipped as usize + received.len(), 100);
}

#[test]
fn publisher_as_fast_as_asked_is_not_thinned() {
    let mut world = World::new();
    world.subscribe("laptop", "wombat-1/pose", Some(20.0), false);
    for number in 0..100 {
        world.publish("pose", &number.to_string());
        // Its intervals vary.
        world.pass(Duration::from_millis(if number % 2 == 0 { 46 } else { 54 }));
    }
    assert_eq!(world.values(0).len(), 100);
}

#[test]
fn robot_with_several_wishes_gets_the_largest_and_each_subscriber_its_own() {
    let mut world = World::new();
    for hz in [20.0, 5.0, 1.0] {
        world.subscribe("laptop", "wombat-1/pose", Some(hz), false);
    }
    world.subscribe("phone", "wombat-1/pose", Some(1.0), false);
    world.publish_at(50, "pose", 500);
    world.pass(Duration::from_secs(5));
    // One more, since the last value is repeated for the slower ones.
    let sent = world.sent_to("laptop", "pose");
    assert!((200..=202).contains(&sent), "{sent}");
    for (subscriber, expected) in [(0, 200), (1, 50), (2, 10), (3, 10)] {
        let values = world.values(subscriber);
        let about = expected..=expected + 2;
        assert!(
            about.contains(&values.len()),
            "{subscriber}: {}",
            values.len()
        );
        assert_eq!(
            values.last().map(String::as_str),
            Some("499"),
            "{subscriber}"
        );
        let numbers: Vec<u32> = values
            .iter()
            .map(|value| value.parse().expect("a number"))
            .collect();
        assert!(
            numbers.windows(2).all(|pair| pair[0] < pair[1]),
            "{numbers:?}"
        );
    }
    assert!((10..=12).contains(&world.sent_to("phone", "pose")));
}

#[test]
fn equal_values_are_not_sent_to_those_who_want_changes() {
    let mut world = World::new();
    world.subscribe("laptop", "wombat-1/*", None, true);
    for value in ["a", "a", "b", "b", "a", "a"] {
        world.publish("mode", value);
        world.pass(Duration::from_millis(100));
    }
    assert_eq!(world.values(0), ["a", "b", "a"]);
    assert_eq!(world.sent_to("laptop", "mode"), 3);
    // Another subscriber of the same robot wants all, at most ten a second.
    world.subscribe("laptop", "wombat-1/mode", Some(10.0), false);
    for value in ["a", "a", "b"] {
        world.publish("mode", value);
        world.pass(Duration::from_millis(100));
    }
    assert_eq!(world.values(1), ["a", "a", "b"]);
    assert_eq!(world.values(0), ["a", "b", "a", "b"]);
}

#[test]
fn changes_that_follow_each_other_at_once_all_arrive() {
    let mut world = World::new();
    world.subscribe("laptop", "wombat-1/mode", None, true);
    world.publish("mode", "a");
    let subscriber = world.subscriber();
    // The executor is busy, and polls only after all of them.
    for value in ["b", "b", "c", "d"] {
        let payload = Payload::new(value, Encoding::TEXT);
        let sample = sample("rect/wombat-1/mode".to_owned(), payload, None, false);
        let event = Event::Sample {
            id: subscriber,
            sample,
        };
        let _ = world.throttle.on_event(world.now, event);
    }
    world.poll();
    assert_eq!(world.values(0), ["a", "b", "c", "d"]);
    // A link that is too slow for a flood holds up a limited number.
    for number in 0..10_000 {
        let payload = Payload::new(number.to_string(), Encoding::TEXT);
        let sample = sample("rect/wombat-1/mode".to_owned(), payload, None, false);
        let event = Event::Sample {
            id: subscriber,
            sample,
        };
        let _ = world.throttle.on_event(world.now, event);
    }
    assert!(world.throttle.actions.len() <= MAX_ACTIONS);
    world.poll();
    assert_eq!(world.values(0).last().map(String::as_str), Some("9999"));
}

#[test]
fn lost_messages_count_as_missed() {
    let mut world = World::new();
    world.subscribe("laptop", "wombat-1/pose", Some(10.0), false);
    world.publish_at(10, "pose", 3);
    world.lost = 2;
    world.publish_at(10, "pose", 4);
    let missed: Vec<u32> = (world.subscribers[0].messages.iter())
        .map(|(_, message)| message.missed)
        .collect();
    assert_eq!(missed, [0, 0, 0, 2, 0]);
    let skipped = |(_, message): &(Duration, Message)| message.skipped;
    assert_eq!(
        world.subscribers[0]
            .messages
            .iter()
            .map(skipped)
            .sum::<u32>(),
        0
    );
}

#[test]
fn wish_that_has_ended_costs_nothing() {
    let mut world = World::new();
    world.subscribe("laptop", "*/pose", Some(5.0), false);
    world.publish_at(10, "pose", 10);
    let token = world.subscribers[0]
        .inbound
        .token()
        .expect("a wish")
        .to_owned();
    let sent = world.sent_to("laptop", "pose");
    world.token(token.clone(), true);
    world.publish_at(10, "pose", 10);
    assert_eq!(world.sent_to("laptop", "pose"), sent);
    assert_eq!(world.declared.len(), 1, "{:?}", world.declared);
    // It returns, as after a cut. Nothing before it counts as missed.
    world.token(token, false);
    world.publish_at(10, "pose", 10);
    let missed = world.subscribers[0]
        .messages
        .iter()
        .map(|(_, message)| message.missed);
    assert_eq!(missed.sum::<u32>(), 0);
}

#[test]
fn wish_that_changes_every_second_is_followed() {
    let mut world = World::new();
    for second in 0..10 {
        let hz = if second % 2 == 0 { 1.0 } else { 10.0 };
        world.subscribe("laptop", "wombat-1/pose", Some(hz), false);
        if second > 0 {
            let token = world.subscribers[second - 1]
                .inbound
                .token()
                .expect("a wish")
                .to_owned();
            world.token(token, true);
        }
        world.publish_at(50, "pose", 50);
    }
    assert!(
        (50..70).contains(&world.sent_to("laptop", "pose")),
        "{:?}",
        world.sent
    );
    assert_eq!(world.declared.len(), 3);
}

#[test]
fn flood_of_wishes_is_bounded_and_named() {
    let mut world = World::new();
    for number in 0..10_000 {
        world.token(
            format!("rect/laptop/@rect/throttle/2/wombat-1/topic/{number}"),
            false,
        );
    }
    for number in 0..100 {
        world.token(
            format!("rect/robot-{number}/@rect/throttle/2/*/pose"),
            false,
        );
    }
    assert_eq!(world.warnings.len(), 1, "{:?}", world.warnings);
    assert!(
        world.warnings[0].contains("laptop has asked for more than 256"),
        "{:?}",
        world.warnings
    );
    // One for each topic of the laptop, one for `pose`, and that of the tokens.
    assert_eq!(world.declared.len(), 258);
    for key in [
        "rect/a/@rect/throttle/2/wombat-1/a$b",
        "rect/a/@rect/throttle/0/*/pose",
        "rect//@rect/throttle/2/*/x",
    ] {
        world.token(key.to_owned(), false);
    }
    assert_eq!(world.declared.len(), 258);
}

#[test]
fn directed_retained_and_foreign_messages_stay() {
    let mut world = World::new();
    world.subscribe("laptop", "wombat-1/**", Some(10.0), false);
    world.publish("to/phone/secret", "a");
    let subscriber = world.subscriber();
    for attachment in [None, Some(vec![0xF7, 0, 0].into())] {
        let payload = Payload::new("x", Encoding::TEXT);
        let sample = sample("rect/wombat-1/mode".to_owned(), payload, attachment, false);
        world.event(Event::Sample {
            id: subscriber,
            sample,
        });
        world.pass(Duration::from_secs(1));
    }
    // A message of a program that does not use RECT has no attachment.
    assert_eq!(world.values(0), ["x"]);
    assert_eq!(world.sent.len(), 1);
}
