//! Drives a request that is repeated until there is a reply, and is carried out at most once.
//!
//! It asks the robot's catalogue which run of a program serves the topic, and names that run in the request. If a query ends without
//! a reply, the catalogue shows whether that run still exists. The answers of the catalogue are kept, so that nothing crosses the air
//! for that while the robot's programs stay the same.
use std::time::{Duration, Instant};

use super::once::{Unrepeated, MAX_TIMEOUT};
use crate::{
    catalogue::{self, Instance},
    driver::{Action, Driver, Event, Id, Reaction, Step},
    message::{payload::Payload, urgency::Urgency},
    name::Name,
    registry::{
        catalogue_query::{CatalogueQuery, Catalogues},
        RegistryError,
    },
    session::inquiry::{Inquiry, ReplyKind},
};

/// The pause before a request is repeated. It doubles until [`LONGEST_PAUSE`].
const PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);
/// The time for which the run of the program may be missing in the catalogue, while no other one serves the topic: after a restart of the
/// robot's router its programs register again.
const MISSING: Duration = Duration::from_secs(3);
/// How long a query may have no reply before the request is sent again. It doubles. A query that a router forwards when a program ends may
/// never end (tests/upstream/unfinished_query.py).
const RESEND_AFTER: Duration = Duration::from_secs(3);
/// The ids of the queries of one step begin at its number times this. A query of an earlier step may end late.
const IDS_OF_STEP: u64 = 1000;

/// A request that is repeated.
#[derive(Debug)]
pub struct RetriedRequest {
    inquiry: Inquiry,
    robot: Name,
    payload: Payload,
    urgency: Urgency,
    catalogues: Catalogues,
    deadline: Instant,
    /// The run of the program that may carry out the request; `None` until the catalogue has been read.
    once_by: Option<Instance>,
    missing_since: Option<Instant>,
    pause: Duration,
    resend_after: Duration,
    /// The number of the step, for the ids of its queries.
    step: u64,
    state: State,
}

#[derive(Debug)]
enum State {
    /// Asks which programs there are. `has_ended`: a query has just ended without a reply.
    LookingUp {
        query: Box<CatalogueQuery>,
        has_ended: bool,
    },
    /// Sends the request to that run of the program next.
    Ready(Instance),
    /// Waits for the reply, until this time.
    Asking(Instant),
    /// Waits before it sends the request to that run of the program again, or else (`None`) looks up the program again.
    Pausing {
        until: Instant,
        then_to: Option<Instance>,
    },
    Finished(Outcome),
}

/// The result of a request that is repeated.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The service replied, or the time is up.
    Replied(ReplyKind),
    /// Nothing was sent: no program of RECT serves the topic at this robot. An ordinary request reaches a service of stock Zenoh.
    Plain,
    /// The request may have been carried out, at most once, and no reply follows: the program has ended, or does not keep its reply.
    Interrupted,
    /// The session is closed.
    Closed,
}

/// The timeout of a request that is repeated is too long.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a request that is repeated has a timeout of at most {} s", MAX_TIMEOUT.as_secs())]
pub struct TooLong;

impl RetriedRequest {
    /// Creates the request `inquiry` to `robot`, whose timeout begins now.
    ///
    /// # Errors
    /// Returns [`TooLong`] if the timeout is.
    pub fn new(
        now: Instant,
        inquiry: Inquiry,
        robot: Name,
        payload: Payload,
        urgency: Urgency,
        catalogues: Catalogues,
    ) -> Result<Self, TooLong> {
        if inquiry.timeout() > MAX_TIMEOUT {
            return Err(TooLong);
        }
        let query = Box::new(catalogues.query(inquiry.place().clone(), robot.clone()));
        Ok(Self {
            deadline: now + inquiry.timeout(),
            inquiry,
            robot,
            payload,
            urgency,
            catalogues,
            once_by: None,
            missing_since: None,
            pause: PAUSE,
            resend_after: RESEND_AFTER,
            step: 0,
            state: State::LookingUp {
                query,
                has_ended: false,
            },
        })
    }

    fn look_up(&mut self, has_ended: bool) {
        let place = self.inquiry.place().clone();
        let query = self.catalogues.query(place, self.robot.clone());
        self.step += 1;
        self.state = State::LookingUp {
            query: Box::new(query),
            has_ended,
        };
    }

    fn pause(&mut self, now: Instant, then_to: Option<Instance>) {
        let until = now + self.pause;
        self.pause = (self.pause * 2).min(LONGEST_PAUSE);
        self.state = State::Pausing { until, then_to };
    }

    fn finish(&mut self, outcome: Outcome) {
        self.state = State::Finished(outcome);
    }

    fn on_catalogue(
        &mut self,
        now: Instant,
        found: Result<Payload, RegistryError>,
        has_ended: bool,
    ) {
        let programs = match found {
            Ok(found) => catalogue::read(&found.bytes).ok(),
            Err(RegistryError::Closed) => return self.finish(Outcome::Closed),
            // The link is slow, or has just been cut.
            Err(RegistryError::TimedOut { .. }) => return self.pause(now, None),
            Err(RegistryError::NoService { .. } | RegistryError::Rejected(_)) => None,
        };
        let serving = programs.map(|programs| {
            let programs = programs.into_iter();
            let serving = programs.filter(|program| program.serves(self.inquiry.topic()));
            serving.map(|program| program.instance).collect::<Vec<_>>()
        });
        match (self.once_by, serving.as_deref()) {
            (None, None | Some([])) => self.finish(Outcome::Plain),
            (None, Some([first, ..])) => {
                self.once_by = Some(*first);
                self.state = State::Ready(*first);
            }
            // The robot cannot be reached.
            (Some(_), None) => self.pause(now, None),
            (Some(run), Some(serving)) if serving.contains(&run) => {
                self.missing_since = None;
                match has_ended {
                    true => self.pause(now, Some(run)),
                    false => self.state = State::Ready(run),
                }
            }
            (Some(_), Some(others)) => {
                let since = *self.missing_since.get_or_insert(now);
                match others.is_empty() && now < since + MISSING {
                    true => self.pause(now, None),
                    false => self.finish(Outcome::Interrupted),
                }
            }
        }
    }

    fn on_reply(&mut self, kind: ReplyKind) {
        let refusal = match &kind {
            ReplyKind::Error { payload, .. } => Unrepeated::of(payload),
            _ => None,
        };
        match refusal {
            // The run that the request names may still reply, if several programs serve the topic.
            Some(Unrepeated::AnotherRun) => {}
            Some(Unrepeated::NotKept) => self.finish(Outcome::Interrupted),
            None => self.finish(Outcome::Replied(kind)),
        }
    }

    fn first_id(&self) -> u64 {
        self.step * IDS_OF_STEP
    }

    /// Returns the event with the id that the step has given its query; `None` if it is of another step.
    fn of_step(&self, event: Event) -> Option<Event> {
        let own = |id: Id| {
            let id = id.0.checked_sub(self.first_id())?;
            (id < IDS_OF_STEP).then_some(Id(id))
        };
        match event {
            Event::Reply { id, reply } => own(id).map(|id| Event::Reply { id, reply }),
            Event::Ended { id } => own(id).map(|id| Event::Ended { id }),
            _ => None,
        }
    }
}

impl Driver for RetriedRequest {
    type Item = std::convert::Infallible;
    type Output = Outcome;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        if event == Event::Closed {
            self.finish(Outcome::Closed);
            return Reaction::POLL;
        }
        let Some(event) = self.of_step(event) else {
            return Reaction::NONE;
        };
        match (&mut self.state, event) {
            (State::LookingUp { query, .. }, event) => return query.on_event(now, event),
            (State::Asking(_), Event::Reply { reply, .. }) => {
                if let Some(kind) = self.inquiry.on_reply(reply) {
                    self.on_reply(kind);
                }
            }
            (State::Asking(_), Event::Ended { .. }) => self.look_up(true),
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        loop {
            if now >= self.deadline && !matches!(self.state, State::Finished(_)) {
                self.finish(Outcome::Replied(ReplyKind::TimedOut));
            }
            let first_id = self.first_id();
            match &mut self.state {
                State::LookingUp { query, has_ended } => match query.poll(now) {
                    Step::Act(Action::Get { id, get }) => {
                        let id = Id(first_id + id.0);
                        return Step::Act(Action::Get { id, get });
                    }
                    Step::Act(action) => return Step::Act(action),
                    Step::Deliver(never) => match never {},
                    Step::Wait(until) => {
                        let until = until.map_or(self.deadline, |until| until.min(self.deadline));
                        return Step::Wait(Some(until));
                    }
                    Step::Finished(found) => {
                        let has_ended = *has_ended;
                        self.on_catalogue(now, found, has_ended);
                    }
                },
                State::Ready(once_by) => {
                    let once_by = *once_by;
                    self.step += 1;
                    self.state = State::Asking(now + self.resend_after);
                    self.resend_after *= 2;
                    let (id, left) = (Id(self.first_id()), self.deadline - now);
                    let (payload, urgency) = (self.payload.clone(), self.urgency);
                    let get = self.inquiry.get_once(once_by, left, payload, urgency);
                    return Step::Act(Action::Get { id, get });
                }
                State::Asking(until) if now < *until => {
                    return Step::Wait(Some((*until).min(self.deadline)));
                }
                State::Asking(_) => self.look_up(true),
                State::Pausing { until, .. } if now < *until => {
                    return Step::Wait(Some((*until).min(self.deadline)));
                }
                State::Pausing { then_to, .. } => match *then_to {
                    Some(run) => self.state = State::Ready(run),
                    None => self.look_up(false),
                },
                State::Finished(outcome) => return Step::Finished(outcome.clone()),
            }
        }
    }
}
