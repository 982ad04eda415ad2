//! The retained messages of a program: the driver of its state with subscriptions, and the publication of a value.
use std::time::Instant;

use rect_core::{
    driver::{Driver, Event, Reaction, Step},
    message::{attachment::Sent, urgency::Urgency, Inbound, Message},
    name::{
        key::{Audience, KeySpace},
        topic::{Pattern, Topic},
    },
    state::{page, program::ProgramState, retain::Retain},
};
use serde_json::{json, Value};

use super::{
    arguments::{self, number, run, text},
    content, nothing,
};

/// A program. Its driver delivers what the subscriptions receive.
pub struct Program {
    place: KeySpace,
    state: ProgramState,
    subscriptions: Vec<Inbound>,
}

impl Program {
    pub fn new(place: KeySpace, run: u32, now: Instant) -> Self {
        Self {
            state: ProgramState::new(place.clone(), run, now),
            place,
            subscriptions: Vec::new(),
        }
    }

    /// Performs a call of a step: `subscribe` to a pattern, or `publish` a value, which the router keeps with this answer.
    pub fn call(&mut self, now: Instant, name: &str, arguments: &[Value]) -> Value {
        match (name, arguments) {
            ("subscribe", [pattern]) => {
                let pattern = Pattern::new(text(pattern)).expect("a pattern");
                let selected = self.place.subscriptions(&pattern);
                let of_all = selected.iter().filter(|one| one.audience == Audience::All);
                let keys: Vec<_> = of_all.map(|one| one.key.clone()).collect();
                let number = self.state.subscribe(&keys, now);
                let inbound = Inbound::new(self.place.clone(), selected, now);
                self.subscriptions.push(inbound);
                json!(number)
            }
            ("publish", [topic, bytes, encoding, unix_ms, kept]) => {
                let (topic, order) = order(&mut self.state, [topic, bytes, encoding, unix_ms]);
                let kept = page::read(&content::parse(kept)).expect("an answer");
                self.state.on_kept(topic, &order, kept, now);
                nothing()
            }
            _ => panic!("no call {name}"),
        }
    }
}

impl Driver for Program {
    type Item = Vec<Message>;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Vec<Message>> {
        let reaction = self.state.on_event(now, event);
        assert!(reaction.items.is_empty());
        match reaction.polls {
            true => Reaction::POLL,
            false => Reaction::NONE,
        }
    }

    fn poll(&mut self, now: Instant) -> Step<Vec<Message>, ()> {
        match self.state.poll(now) {
            Step::Deliver(arrival) => {
                let all = self.subscriptions.iter_mut();
                Step::Deliver(all.flat_map(|one| one.on_retained(&arrival)).collect())
            }
            Step::Act(action) => Step::Act(action),
            Step::Wait(until) => Step::Wait(until),
            Step::Finished(()) => Step::Finished(()),
        }
    }
}

/// Returns the publication of a value by the first call of a program.
pub fn retain(place: &KeySpace, driver: &Value, now: Instant) -> Retain {
    let mut state = ProgramState::new(place.clone(), run(driver), now);
    let fields = ["topic", "bytes", "encoding", "unix_ms"].map(|field| &driver[field]);
    let (_, order) = order(&mut state, fields);
    Retain::new(place, &order, now)
}

fn order(
    state: &mut ProgramState,
    [topic, bytes, encoding, unix_ms]: [&Value; 4],
) -> (Topic, page::Order) {
    let topic = arguments::topic(text(topic));
    let sent = Sent::At(number(unix_ms));
    let payload = arguments::payload(bytes, encoding);
    let order = state.set(&topic, payload, Urgency::Normal, false, sent);
    (topic, order)
}
