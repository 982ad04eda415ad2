//! Drives the throttle of a robot, for its router or for a program without one: sends other robots as many messages of a topic as they
//! asked for, and no more. [`crate::message::throttled`] describes what goes over the air.
//!
//! A robot gets one stream for each topic, as fast as the largest of its wishes. The newest value wins: one that comes too early waits
//! until it is due, and is replaced by a newer one. So the last value always arrives. If some of a robot's subscribers want less than
//! others, the last value is repeated once, since those may have left it out.
mod stream;
#[cfg(test)]
mod tests;
mod wishes;

use std::{
    collections::{BTreeMap, VecDeque},
    time::Instant,
};

use self::{
    stream::{Received, Stream},
    wishes::{Route, Wishes},
};
use crate::{
    driver::{Action, Declaration, Driver, Event, Id, Reaction, Sample, Step},
    message::{
        retained::live,
        throttled::{publication, tokens},
        urgency::Urgency,
    },
    name::{key::KeySpace, topic::Topic, Name},
};

/// The maximum number of streams; messages of further topics are not sent.
pub const MAX_STREAMS: usize = 1024;

/// The number of actions from which on messages wait with their streams, where newer ones replace them: a link that is slower than the
/// messages holds the actions up.
const MAX_ACTIONS: usize = 256;

const TOKENS: Id = Id(0);
/// The ids of subscribers and publishers follow this one.
const FIRST: u64 = 1;

/// Sends each robot the messages for which its subscribers have asked.
#[derive(Debug)]
pub struct Throttle {
    place: KeySpace,
    wishes: Wishes,
    /// The subscribers to own topics, by key expression.
    subscribers: BTreeMap<String, Id>,
    /// The streams, by topic and receiver.
    streams: BTreeMap<(String, Name), Publishing>,
    next: u64,
    actions: VecDeque<Action>,
    warnings: VecDeque<String>,
    has_warned: bool,
    is_closed: bool,
}

/// A stream with its publisher.
#[derive(Debug)]
struct Publishing {
    publisher: Id,
    urgency: Urgency,
    stream: Stream,
}

impl Throttle {
    /// Creates the throttle of the robot of `place`.
    pub fn new(place: KeySpace) -> Self {
        let declaration = Declaration::LivelinessSubscriber {
            key: tokens(&place),
        };
        let declare = Action::Declare {
            id: TOKENS,
            declaration,
        };
        Self {
            place,
            wishes: Wishes::default(),
            subscribers: BTreeMap::new(),
            streams: BTreeMap::new(),
            next: FIRST,
            actions: [declare].into(),
            warnings: VecDeque::new(),
            has_warned: false,
            is_closed: false,
        }
    }

    fn next_id(&mut self) -> Id {
        let id = Id(self.next);
        self.next += 1;
        id
    }

    /// Handles that a wish has appeared or ended.
    fn on_token(&mut self, token: &Sample) {
        match self
            .wishes
            .on_token(&self.place, &token.key, token.is_deleted)
        {
            Ok(true) => {}
            Ok(false) => return,
            Err(warning) => return self.warn(warning),
        }
        let patterns = self.wishes.patterns();
        let ended = |key: &String| !patterns.contains(key.as_str());
        let ended: Vec<_> = self
            .subscribers
            .keys()
            .filter(|key| ended(key))
            .cloned()
            .collect();
        let new: Vec<_> = (patterns.into_iter())
            .filter(|key| !self.subscribers.contains_key(*key))
            .map(str::to_owned)
            .collect();
        for key in ended {
            if let Some(id) = self.subscribers.remove(&key) {
                self.actions.push_back(Action::Undeclare { id });
            }
        }
        for pattern in new {
            let id = self.next_id();
            let key = self.place.publication_of(&pattern);
            let declaration = Declaration::Subscriber { key };
            self.actions.push_back(Action::Declare { id, declaration });
            self.subscribers.insert(pattern, id);
        }
        let (wishes, actions) = (&mut self.wishes, &mut self.actions);
        self.streams.retain(|(topic, receiver), publishing| {
            let route = wishes.route(topic, receiver);
            match &route {
                Some(route) => publishing.stream.set_asked(route.asked),
                None => actions.push_back(Action::Undeclare {
                    id: publishing.publisher,
                }),
            }
            route.is_some()
        });
    }

    /// Handles a message of this robot that a subscriber has received. Returns whether something is due.
    fn on_message(&mut self, id: Id, sample: Sample, now: Instant) -> bool {
        let prefix = self.place.publication_of("");
        let topic = (sample.key.strip_prefix(&prefix)).and_then(|text| Topic::new(text).ok());
        // Retained values reach their subscribers as state.
        let is_retained = sample.attachment.as_deref().is_some_and(live::is_live);
        let Some(topic) = topic.filter(|_| !sample.is_deleted && !is_retained) else {
            return false;
        };
        let subscribers = &self.subscribers;
        let routes: Vec<Route> = (self.wishes.routes(topic.as_str()).iter())
            .filter(|route| subscribers.get(&route.pattern) == Some(&id))
            .cloned()
            .collect();
        let received = Received {
            payload: sample.payload,
            attachment: sample.attachment,
        };
        let urgency = Urgency::from_priority(sample.priority);
        let mut polls = false;
        for route in routes {
            let key = (topic.as_str().to_owned(), route.receiver);
            let known = self.streams.get(&key).map(|publishing| publishing.urgency);
            if known.is_none() && self.streams.len() >= MAX_STREAMS {
                self.warn(format!(
                    "other robots have asked for messages of more than {MAX_STREAMS} topics with max_hz or on_change: the messages of {topic} are not sent to {}",
                    key.1
                ));
                polls = true;
                continue;
            }
            if known != Some(urgency) {
                let publisher = self.declare_publisher(&key.1, topic.as_str(), urgency);
                let stream = match self.streams.remove(&key) {
                    Some(before) => {
                        let id = before.publisher;
                        self.actions.push_back(Action::Undeclare { id });
                        before.stream
                    }
                    None => Stream::new(route.asked, now),
                };
                let publishing = Publishing {
                    publisher,
                    urgency,
                    stream,
                };
                self.streams.insert(key.clone(), publishing);
            }
            if let Some(publishing) = self.streams.get_mut(&key) {
                polls |= publishing.stream.on_message(received.clone(), now);
                // A message that is due does not wait for the next poll, where a newer one would replace it.
                if self.actions.len() < MAX_ACTIONS {
                    let put = publishing.put(now);
                    polls |= put.is_some();
                    self.actions.extend(put);
                }
            }
        }
        polls
    }

    fn declare_publisher(&mut self, receiver: &Name, topic: &str, urgency: Urgency) -> Id {
        let id = self.next_id();
        let declaration = Declaration::Publisher {
            key: publication(&self.place, receiver, topic),
            qos: urgency.qos(),
            observes_matching: false,
        };
        self.actions.push_back(Action::Declare { id, declaration });
        id
    }

    /// Warns once: what there is too much of is likely to be asked for again.
    fn warn(&mut self, warning: String) {
        if !std::mem::replace(&mut self.has_warned, true) {
            self.warnings.push_back(warning);
        }
    }
}

impl Publishing {
    /// Returns how to send a message that is due.
    fn put(&mut self, now: Instant) -> Option<Action> {
        let (payload, attachment) = self.stream.poll(now)?;
        Some(Action::Put {
            publisher: self.publisher,
            payload,
            attachment: Some(attachment),
        })
    }
}

impl Driver for Throttle {
    /// A warning.
    type Item = String;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<String> {
        let polls = match event {
            Event::Sample { id: TOKENS, sample } => {
                self.on_token(&sample);
                true
            }
            Event::Sample { id, sample } => self.on_message(id, sample, now),
            Event::Closed => {
                self.is_closed = true;
                true
            }
            _ => false,
        };
        match polls {
            true => Reaction::POLL,
            false => Reaction::NONE,
        }
    }

    fn poll(&mut self, now: Instant) -> Step<String, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if let Some(action) = self.actions.pop_front() {
            return Step::Act(action);
        }
        if let Some(warning) = self.warnings.pop_front() {
            return Step::Deliver(warning);
        }
        let mut next = None::<Instant>;
        for publishing in self.streams.values_mut() {
            if let Some(put) = publishing.put(now) {
                return Step::Act(put);
            }
            next = [next, publishing.stream.due()].into_iter().flatten().min();
        }
        Step::Wait(next)
    }
}
