//! Drives the questions which robots are reachable, and the wait for one of them.
use std::{
    collections::BTreeSet,
    time::{Duration, Instant},
};

use super::{
    driver::{Action, Declaration, Driver, Event, Get, Id, Reaction, Step, Target},
    key::KeySpace,
    name::Name,
};

/// The timeout of a question to the routers. They reply at once, but a slow and busy link delays the reply.
pub const TIMEOUT: Duration = Duration::from_secs(5);
/// The part after `@rect/` of the keys of the liveliness tokens of robots.
const ALIVE: &str = "alive/*";
/// The maximum number of robots in an answer.
const MAX_PEERS: usize = 4096;
const QUERY: Id = Id(0);
const TOKENS: Id = Id(1);

/// Returns the key expression of the liveliness tokens of `robot`, or of all robots (`None`).
pub fn tokens(place: &KeySpace, robot: Option<&Name>) -> String {
    place.own(robot, ALIVE)
}

/// Returns the key of the liveliness token of the robot of `place`, for the Zenoh session `id`. A program that declares it
/// also answers questions on this key, with an empty payload, for [`EstablishedWait`]. It declares the queryable first, so
/// that a program that knows the token can ask.
pub fn token(place: &KeySpace, id: &str) -> String {
    place.own(Some(&place.robot), &format!("alive/{id}"))
}

/// Asks which other robots of the fleet are reachable. Finishes with their names in alphabetical order.
#[derive(Debug)]
pub struct PeersQuery {
    place: KeySpace,
    peers: BTreeSet<Name>,
    is_sent: bool,
    has_ended: bool,
}

impl PeersQuery {
    /// Creates the question of a program of the robot of `place`.
    pub fn new(place: KeySpace) -> Self {
        Self {
            place,
            peers: BTreeSet::new(),
            is_sent: false,
            has_ended: false,
        }
    }
}

impl Driver for PeersQuery {
    type Item = std::convert::Infallible;
    type Output = Vec<Name>;

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Reply { reply, .. } => {
                let robot = reply
                    .ok()
                    .and_then(|sample| self.place.robot_of(&sample.key));
                let other = robot.filter(|robot| *robot != self.place.robot);
                if self.peers.len() < MAX_PEERS {
                    self.peers.extend(other);
                }
                Reaction::NONE
            }
            Event::Ended { .. } | Event::Closed => {
                self.has_ended = true;
                Reaction::POLL
            }
            _ => Reaction::NONE,
        }
    }

    fn poll(&mut self, _now: Instant) -> Step<Self::Item, Self::Output> {
        if self.has_ended {
            return Step::Finished(std::mem::take(&mut self.peers).into_iter().collect());
        }
        if std::mem::replace(&mut self.is_sent, true) {
            return Step::Wait(None);
        }
        let get = Get::liveliness(tokens(&self.place, None), TIMEOUT);
        Step::Act(Action::Get { id: QUERY, get })
    }
}

/// How a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waited {
    /// The condition holds.
    Ready,
    /// The timeout has expired.
    TimedOut,
    /// The session was closed.
    Closed,
}

/// Waits until a robot is reachable.
#[derive(Debug)]
pub struct PeerWait {
    key: String,
    deadline: Instant,
    is_declared: bool,
    waited: Option<Waited>,
}

impl PeerWait {
    /// Creates the wait for `robot`, until `timeout` from `now`.
    pub fn new(place: &KeySpace, robot: &Name, now: Instant, timeout: Duration) -> Self {
        Self {
            key: tokens(place, Some(robot)),
            deadline: deadline(now, timeout),
            is_declared: false,
            waited: None,
        }
    }
}

impl Driver for PeerWait {
    type Item = std::convert::Infallible;
    type Output = Waited;

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        self.waited = match event {
            Event::Sample { sample, .. } if !sample.is_deleted => Some(Waited::Ready),
            Event::Closed => self.waited.or(Some(Waited::Closed)),
            _ => return Reaction::NONE,
        };
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        if let Some(waited) = self.waited {
            return Step::Finished(waited);
        }
        if !std::mem::replace(&mut self.is_declared, true) {
            let key = self.key.clone();
            let declaration = Declaration::LivelinessSubscriber { key };
            let id = TOKENS;
            return Step::Act(Action::Declare { id, declaration });
        }
        if now >= self.deadline {
            return Step::Finished(Waited::TimedOut);
        }
        Step::Wait(Some(self.deadline))
    }
}

/// Waits until all reachable robots know what this program has declared.
///
/// The routers of the fleet are asked for the time. A declaration takes the same way as the question, and precedes it, so
/// that a router that answers knows the declaration. A program without a router answers questions on the key of its
/// liveliness token. Zenoh answers questions about the tokens themselves without asking anyone.
#[derive(Debug)]
pub struct EstablishedWait {
    get: Option<Get>,
    waited: Option<Waited>,
    deadline: Instant,
}

impl EstablishedWait {
    /// Creates the wait of a program, until `timeout` from `now`. `is_direct`: the program has no router.
    pub fn new(place: &KeySpace, is_direct: bool, now: Instant, timeout: Duration) -> Self {
        let key = if is_direct {
            tokens(place, None)
        } else {
            place.own(None, "clock")
        };
        let get = Get {
            target: Target::All,
            ..Get::new(key, timeout)
        };
        Self {
            get: Some(get),
            waited: None,
            deadline: deadline(now, timeout),
        }
    }
}

impl Driver for EstablishedWait {
    type Item = std::convert::Infallible;
    type Output = Waited;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        self.waited = match event {
            Event::Ended { .. } if now >= self.deadline => Some(Waited::TimedOut),
            Event::Ended { .. } => Some(Waited::Ready),
            Event::Closed => self.waited.or(Some(Waited::Closed)),
            _ => return Reaction::NONE,
        };
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        if let Some(get) = self.get.take() {
            return Step::Act(Action::Get { id: QUERY, get });
        }
        match self.waited {
            Some(waited) => Step::Finished(waited),
            None if now >= self.deadline => Step::Finished(Waited::TimedOut),
            None => Step::Wait(Some(self.deadline)),
        }
    }
}

/// Returns the end of a timeout; a timeout beyond the range of the clock counts as a year.
pub fn deadline(now: Instant, timeout: Duration) -> Instant {
    const YEAR: Duration = Duration::from_secs(365 * 24 * 3600);
    now.checked_add(timeout).unwrap_or(now + YEAR)
}
