//! Drives the state that a program receives: waits at the router of its robot for changes, and gives the router the program's own values
//! again after a restart.
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::{Duration, Instant},
};

use zenoh_keyexpr::OwnedKeyExpr;

use super::{
    page::{read, write, Kept, NewValue, Order, Page},
    Origin, Position, OF_PROGRAMS,
};
use crate::{
    driver::{Action, Declaration, Driver, Event, Get, Id, Reaction, Step},
    message::{
        attachment::Sent,
        payload::Payload,
        retained::{value::Value, Arrival, Following},
        urgency::Urgency,
    },
    name::{key::KeySpace, topic::Topic, Name},
};

/// How long a question waits at the router for changes. Only the program's own router is asked.
pub const POLL: Duration = Duration::from_secs(15);
/// The time after which a question without an answer is asked again.
const TIMEOUT: Duration = Duration::from_secs(POLL.as_secs() + 10);
/// The pauses before a question that nobody has answered is asked again; the last one repeats.
const PAUSES: [Duration; 4] = [
    Duration::from_millis(50),
    Duration::from_millis(200),
    Duration::from_millis(500),
    Duration::from_secs(1),
];
/// How long a new subscription waits for others, which are asked for together with it.
const TOGETHER: Duration = Duration::from_millis(2);
/// The number of own topics from which a program asks for all topics of its robot.
const MAX_OWN: usize = 32;
/// The first id of the questions.
const FIRST: u64 = 1;
const LINKS: Id = Id(0);

/// A value that this program has published, which the router keeps.
#[derive(Debug)]
struct Own {
    value: NewValue,
    since: Instant,
}

/// The state that a program receives. Delivers values, with the names of their robots, each to all subscriptions; they select theirs.
#[derive(Debug)]
pub struct ProgramState {
    place: KeySpace,
    /// The run of the program.
    run: u32,
    published: u64,
    subscriptions: BTreeMap<u64, Vec<OwnedKeyExpr>>,
    next_subscription: u64,
    own: BTreeMap<Topic, Own>,
    /// The own topics that the pages since the last question for everything did not contain.
    missing: BTreeSet<Topic>,
    position: Option<Position>,
    /// The run of the router that answered last.
    router: Option<u32>,
    following: Following,
    asking: Option<Id>,
    is_answered: bool,
    attempts: usize,
    ask_at: Option<Instant>,
    /// The values that the router gets again, by the ids of the queries.
    returned: BTreeMap<Id, Topic>,
    next: u64,
    actions: VecDeque<Action>,
    items: VecDeque<Arrival>,
    is_closed: bool,
}

impl ProgramState {
    /// Creates the state of a program of the robot of `place`. `run` is the run of the program.
    pub fn new(place: KeySpace, run: u32, now: Instant) -> Self {
        let declaration = Declaration::LinkListener;
        Self {
            place,
            run,
            published: 0,
            subscriptions: BTreeMap::new(),
            next_subscription: 0,
            own: BTreeMap::new(),
            missing: BTreeSet::new(),
            position: None,
            router: None,
            following: Following::default(),
            asking: None,
            is_answered: false,
            attempts: 0,
            ask_at: Some(now + TOGETHER),
            returned: BTreeMap::new(),
            next: FIRST,
            actions: [Action::Declare {
                id: LINKS,
                declaration,
            }]
            .into(),
            items: VecDeque::new(),
            is_closed: false,
        }
    }

    /// Returns whether retained messages reach the program through its router.
    pub fn following(&self) -> Following {
        self.following.clone()
    }

    /// Adds a subscription to messages with those key expressions. Returns its number.
    pub fn subscribe(&mut self, keys: &[String], now: Instant) -> u64 {
        let keys = keys
            .iter()
            .filter_map(|key| OwnedKeyExpr::autocanonize(key.clone()).ok());
        self.next_subscription += 1;
        self.subscriptions
            .insert(self.next_subscription, keys.collect());
        // It gets the values that others have already.
        self.position = None;
        // The answer to a question without these keys would be incomplete.
        self.asking = None;
        self.ask_at = Some(now + TOGETHER);
        self.next_subscription
    }

    /// Removes a subscription. The router learns it, and ends its own.
    pub fn unsubscribe(&mut self, subscription: u64, now: Instant) {
        self.subscriptions.remove(&subscription);
        self.ask_at = Some(now + TOGETHER);
    }

    fn next_origin(&mut self) -> Origin {
        self.published += 1;
        Origin(self.run, self.published)
    }

    /// Returns the order to publish and keep a value.
    pub fn set(
        &mut self,
        topic: &Topic,
        payload: Payload,
        urgency: Urgency,
        disk: bool,
        sent: Sent,
    ) -> Order {
        Order::Set(NewValue {
            topic: topic.to_string(),
            origin: self.next_origin(),
            sent,
            kept: None,
            age_ms: 0,
            urgency,
            disk,
            encoding: payload.encoding.as_str().to_owned(),
            bytes: payload.bytes,
        })
    }

    /// Returns the order to forget a topic.
    pub fn forget(&mut self, topic: &Topic, sent: Sent) -> Order {
        Order::Forget {
            topic: topic.to_string(),
            origin: self.next_origin(),
            sent,
            age_ms: 0,
        }
    }

    /// Handles that the router keeps a value of the program, or has forgotten it.
    pub fn on_kept(&mut self, topic: Topic, order: &Order, kept: Kept, now: Instant) {
        match order {
            Order::Set(value) if !kept.is_replaced => {
                let value = NewValue {
                    kept: Some(kept.at),
                    ..value.clone()
                };
                let own = Own { value, since: now };
                let is_new = self.own.insert(topic, own).is_none();
                let is_passed = (self.position)
                    .is_some_and(|Position(run, number)| run == kept.at.0 && number > kept.at.1);
                if is_new && is_passed {
                    // Another program may have published the topic meanwhile. The answer to the question before does not contain that.
                    (self.position, self.asking) = (Some(kept.at), None);
                }
                if is_new {
                    self.ask_at.get_or_insert(now + TOGETHER);
                }
            }
            _ => {
                self.own.remove(&topic);
            }
        }
    }

    /// Returns the values of this program that the router keeps.
    #[cfg(test)]
    pub(super) fn own(&self) -> impl Iterator<Item = (&Topic, Origin)> {
        let own = self.own.iter();
        own.map(|(topic, own)| (topic, own.value.origin))
    }

    fn question(&self) -> Order {
        let subscribed = self.subscriptions.values().flatten();
        let mut keys: Vec<_> = subscribed.map(ToString::to_string).collect();
        match self.own.len() > MAX_OWN {
            true => keys.push(self.place.services()),
            false => keys.extend(self.own.keys().map(|topic| self.place.publication(topic))),
        }
        keys.sort();
        keys.dedup();
        Order::Poll {
            program: self.run,
            since: self.position,
            keys,
        }
    }

    fn get(&mut self, order: &Order) -> Id {
        self.next += 1;
        let id = Id(self.next);
        let get = order_to(&self.place, order, TIMEOUT);
        self.actions.push_back(Action::Get { id, get });
        id
    }

    fn on_page(&mut self, page: Page, now: Instant) {
        if self.router.is_some_and(|run| run != page.run) {
            self.give_back(now);
        }
        self.router = Some(page.run);
        let own = self.place.robot.clone();
        for mut value in page.records {
            let robot = value.robot.get_or_insert_with(|| own.clone()).clone();
            if robot == own {
                self.missing.remove(&value.topic);
                self.on_own(&value, page.run);
                value.kept = Some(Position(page.run, value.number));
            }
            let router = page.run;
            self.items.push_back(Arrival::Value { value, router });
        }
        for (robot, at) in page.complete {
            let robot = match robot.as_str() {
                "" => Ok(own.clone()),
                robot => Name::new(robot),
            };
            if let Ok(robot) = robot {
                let router = page.run;
                self.items
                    .push_back(Arrival::Complete { robot, at, router });
            }
        }
        self.position = Some(Position(page.run, page.at));
        if !page.more {
            self.drop_missing(page.run, page.at);
        }
    }

    /// Handles that a router has none of the missing topics up to that number: another program has forgotten them. An answer with
    /// everything does not contain topics that are forgotten.
    fn drop_missing(&mut self, run: u32, at: u64) {
        for topic in std::mem::take(&mut self.missing) {
            let own = self.own.get(&topic);
            let kept = own.and_then(|own| own.value.kept);
            if kept.is_some_and(|Position(of, number)| of == run && number <= at) {
                self.own.remove(&topic);
            }
        }
    }

    /// Handles a value of this robot: another program may have published a topic after this one.
    fn on_own(&mut self, value: &Value, run: u32) {
        let is_replaced = self.own.get(&value.topic).is_some_and(|own| {
            let kept = own.value.kept.filter(|Position(of, _)| *of == run);
            own.value.origin != value.origin && kept.is_some_and(|kept| value.number > kept.1)
        });
        if is_replaced {
            self.own.remove(&value.topic);
        }
    }

    /// Gives the values of this program to a router that has been restarted.
    fn give_back(&mut self, now: Instant) {
        let orders = self.own.iter().map(|(topic, own)| {
            let age = now.saturating_duration_since(own.since);
            (topic.clone(), Order::Set(own.value.clone()).after(age))
        });
        let orders: Vec<_> = orders.collect();
        for (topic, order) in orders {
            let id = self.get(&order);
            self.returned.insert(id, topic);
        }
    }

    fn on_reply(&mut self, id: Id, reply: Result<Payload, Payload>, now: Instant) {
        if let Some(topic) = self.returned.remove(&id) {
            let kept = reply.ok().and_then(|reply| read::<Kept>(&reply.bytes).ok());
            if let (Some(own), Some(kept)) = (self.own.get_mut(&topic), kept) {
                own.value.kept = Some(kept.at);
                if kept.is_replaced {
                    self.own.remove(&topic);
                }
            }
            return;
        }
        if self.asking != Some(id) {
            return;
        }
        let page = reply.ok().and_then(|reply| read::<Page>(&reply.bytes).ok());
        if let Some(page) = page {
            self.is_answered = true;
            self.following.set(true);
            self.on_page(page, now);
        }
    }

    fn on_ended(&mut self, id: Id, now: Instant) {
        if self.asking != Some(id) {
            return;
        }
        self.asking = None;
        if std::mem::take(&mut self.is_answered) {
            self.attempts = 0;
            self.ask_at = Some(now);
            return;
        }
        let pause = PAUSES[self.attempts.min(PAUSES.len() - 1)];
        self.attempts += 1;
        if self.attempts == PAUSES.len() {
            self.following.set(false);
        }
        self.ask_at = Some(now + pause);
    }
}

/// Returns the query that gives an order to the router of a robot's programs.
pub(super) fn order_to(place: &KeySpace, order: &Order, timeout: Duration) -> Get {
    Get {
        payload: Some(write(order)),
        ..Get::new(place.own(Some(&place.robot), OF_PROGRAMS), timeout)
    }
}

impl Driver for ProgramState {
    type Item = Arrival;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Arrival> {
        match event {
            Event::Reply { id, reply } => {
                self.on_reply(id, reply.map(|sample| sample.payload), now);
            }
            Event::Ended { id } => self.on_ended(id, now),
            // The router may be another one, and an earlier question may have been lost.
            Event::Link { up: true, .. } => self.ask_at = Some(now),
            Event::Closed => self.is_closed = true,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Arrival, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if let Some(item) = self.items.pop_front() {
            return Step::Deliver(item);
        }
        if self.ask_at.is_some_and(|at| at <= now) {
            self.ask_at = None;
            match self.position {
                None => self.missing = self.own.keys().cloned().collect(),
                // The question does not name the others.
                Some(_) => self.missing.retain(|topic| self.own.contains_key(topic)),
            }
            let question = self.question();
            self.asking = Some(self.get(&question));
            self.is_answered = false;
        }
        match self.actions.pop_front() {
            Some(action) => Step::Act(action),
            None => Step::Wait(self.ask_at),
        }
    }
}
