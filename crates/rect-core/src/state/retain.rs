//! Drives the publication of a retained message: gives the value to the router of the robot, which publishes it.
use std::time::{Duration, Instant};

use super::{
    page::{read, Kept, Order},
    program::order_to,
};
use crate::{
    driver::{Action, Driver, Event, Id, Reaction, Step},
    message::{
        payload::Payload,
        request::{error_from_payload, is_timeout},
    },
    name::key::KeySpace,
};

/// The time within which the router answers, which is on the same computer.
const TIMEOUT: Duration = Duration::from_secs(5);
/// The time within which a router has to appear that is being restarted.
const WITHIN: Duration = Duration::from_secs(5);
/// The pauses before the value is given again; the last one repeats.
const PAUSES: [Duration; 3] = [
    Duration::from_millis(50),
    Duration::from_millis(200),
    Duration::from_millis(500),
];
const QUERY: Id = Id(0);

/// The reason why a value is not retained if there is nobody who keeps it.
pub const NO_KEEPER: &str =
    "no router of this robot keeps values. Start rect-router, or a later version of it";

/// How it ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The router keeps the value, or has forgotten it.
    Kept(Kept),
    /// It does not, for this reason.
    Refused(String),
    /// There is no router that keeps values.
    NoKeeper,
    /// The session is closed.
    Closed,
}

/// The publication of a retained message, or the end of a topic.
#[derive(Debug)]
pub struct Retain {
    place: KeySpace,
    order: Order,
    begun: Instant,
    until: Instant,
    attempts: usize,
    ask_at: Option<Instant>,
    outcome: Option<Outcome>,
}

impl Retain {
    /// Creates the publication by a program of the robot of `place`.
    pub fn new(place: &KeySpace, order: &Order, now: Instant) -> Self {
        Self {
            place: place.clone(),
            order: order.clone(),
            begun: now,
            until: now + WITHIN,
            attempts: 0,
            ask_at: Some(now),
            outcome: None,
        }
    }

    fn on_reply(&mut self, reply: Result<Payload, Payload>) {
        let outcome = match reply {
            Ok(reply) => read(&reply.bytes).map_or_else(Outcome::Refused, Outcome::Kept),
            Err(error) => match error_from_payload(error) {
                (robot, error) if is_timeout(robot.as_ref(), &error) => return,
                (_, error) => Outcome::Refused(String::from_utf8_lossy(&error.bytes).into_owned()),
            },
        };
        self.outcome.get_or_insert(outcome);
    }
}

impl Driver for Retain {
    type Item = std::convert::Infallible;
    type Output = Outcome;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Reply { reply, .. } => self.on_reply(reply.map(|sample| sample.payload)),
            Event::Ended { .. } if self.outcome.is_none() => {
                let pause = PAUSES[self.attempts.min(PAUSES.len() - 1)];
                self.attempts += 1;
                match now + pause < self.until {
                    true => self.ask_at = Some(now + pause),
                    false => self.outcome = Some(Outcome::NoKeeper),
                }
            }
            Event::Closed => self.outcome = Some(Outcome::Closed),
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Outcome> {
        if let Some(outcome) = &self.outcome {
            return Step::Finished(outcome.clone());
        }
        if self.ask_at.is_some_and(|at| at <= now) {
            self.ask_at = None;
            let order = self.order.after(now.saturating_duration_since(self.begun));
            let get = order_to(&self.place, &order, TIMEOUT);
            return Step::Act(Action::Get { id: QUERY, get });
        }
        Step::Wait(self.ask_at)
    }
}
