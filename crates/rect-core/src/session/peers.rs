//! Drives the questions which robots are reachable, the waits for one of them, and the presence of a program without a
//! router.
use std::{
    collections::{BTreeSet, VecDeque},
    time::{Duration, Instant},
};

use serde_json::json;

use super::names::reachable_robots;
use crate::{
    clock::MillisecondClock,
    driver::{
        question::{Next, Question},
        Action, Answer, Declaration, Driver, Event, Get, Id, QueryId, Reaction, Step, Target,
    },
    message::{encoding::Encoding, payload::Payload},
    name::{key::KeySpace, Name},
};

/// The timeout of a question to the routers. They reply at once, but a slow and busy link delays the reply.
pub const TIMEOUT: Duration = Duration::from_secs(5);
/// The part after `@rect/` of the keys of the liveliness tokens of robots.
const ALIVE: &str = "alive/*";
/// The part after `@rect/` of the key at which a router, or a program without one, tells the time.
const CLOCK: &str = "clock";
/// The maximum number of robots in an answer.
const MAX_PEERS: usize = 4096;
/// How often [`PeersQuery`] asks at once.
const QUESTIONS: usize = 2;
const QUERY: Id = Id(0);
const TOKENS: Id = Id(1);
const OWN_TOKEN: Id = Id(0);
const OWN_CLOCK: Id = Id(1);

/// Returns the description of a connection with `robot`, for which a program has waited in vain, and of what there is instead.
pub fn expected_connection(robot: &Name, reachable: &[Name]) -> String {
    format!(
        "connection with {robot} ({})",
        reachable_robots(robot, reachable)
    )
}

/// Returns the key expression of the liveliness tokens of `robot`, or of all robots (`None`).
pub fn tokens(place: &KeySpace, robot: Option<&Name>) -> String {
    place.own(robot, ALIVE)
}

/// Returns the key of the liveliness token of the robot of `place`, for the Zenoh session `id`.
fn token(place: &KeySpace, id: &str) -> String {
    place.own(Some(&place.robot), &format!("alive/{id}"))
}

/// Asks which other robots of the fleet are reachable. Finishes with their names in alphabetical order.
///
/// The question is sent twice, which costs one more round trip to the program's own router. If the session has just
/// declared a liveliness subscriber, Zenoh 1.10 delivers the tokens to that subscriber and ends the first question without
/// an answer (`tests/upstream/missing_tokens.py`); the second question follows the tokens on the same connection. On a busy
/// computer the second one can be lost in the same way, so the question is repeated after pauses while nobody has answered.
#[derive(Debug)]
pub struct PeersQuery {
    place: KeySpace,
    peers: BTreeSet<Name>,
    is_own_known: bool,
    question: Question,
}

impl PeersQuery {
    /// Creates the question of a program of the robot of `place`.
    pub fn new(place: KeySpace) -> Self {
        Self {
            place,
            peers: BTreeSet::new(),
            is_own_known: false,
            question: Question::new(QUESTIONS),
        }
    }

    /// Returns whether the own robot has answered, too.
    pub(super) fn is_own_known(&self) -> bool {
        self.is_own_known
    }
}

impl Driver for PeersQuery {
    type Item = std::convert::Infallible;
    type Output = Vec<Name>;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Reply { reply, .. } => {
                let robot = reply
                    .ok()
                    .and_then(|sample| self.place.robot_of(&sample.key));
                self.is_own_known |= robot.as_ref() == Some(&self.place.robot);
                let other = robot.filter(|robot| *robot != self.place.robot);
                if self.peers.len() < MAX_PEERS {
                    self.peers.extend(other);
                }
                Reaction::NONE
            }
            Event::Ended { .. } => {
                self.question.on_ended(now, !self.peers.is_empty());
                Reaction::POLL
            }
            Event::Closed => {
                self.question.finish();
                Reaction::POLL
            }
            _ => Reaction::NONE,
        }
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        match self.question.next(now) {
            Next::Ask => {
                let get = Get::liveliness(tokens(&self.place, None), TIMEOUT);
                Step::Act(Action::Get { id: QUERY, get })
            }
            Next::At(at) => Step::Wait(Some(at)),
            Next::Wait => Step::Wait(None),
            Next::Finish => Step::Finished(std::mem::take(&mut self.peers).into_iter().collect()),
        }
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

/// The state of a wait: its first action, its end, and the outcome once it is known.
#[derive(Debug)]
struct Wait {
    first: Option<Action>,
    deadline: Instant,
    waited: Option<Waited>,
}

impl Wait {
    fn new(first: Action, now: Instant, timeout: Duration) -> Self {
        Self {
            first: Some(first),
            deadline: deadline(now, timeout),
            waited: None,
        }
    }

    fn on_waited(&mut self, waited: Waited) -> Reaction<std::convert::Infallible> {
        self.waited.get_or_insert(waited);
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<std::convert::Infallible, Waited> {
        if let Some(first) = self.first.take() {
            return Step::Act(first);
        }
        match self.waited {
            Some(waited) => Step::Finished(waited),
            None if now >= self.deadline => Step::Finished(Waited::TimedOut),
            None => Step::Wait(Some(self.deadline)),
        }
    }
}

/// Waits until a robot is reachable.
#[derive(Debug)]
pub struct PeerWait(Wait);

impl PeerWait {
    /// Creates the wait for `robot`, until `timeout` from `now`.
    pub fn new(place: &KeySpace, robot: &Name, now: Instant, timeout: Duration) -> Self {
        let key = tokens(place, Some(robot));
        let declare = Action::Declare {
            id: TOKENS,
            declaration: Declaration::LivelinessSubscriber { key },
        };
        Self(Wait::new(declare, now, timeout))
    }
}

impl Driver for PeerWait {
    type Item = std::convert::Infallible;
    type Output = Waited;

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Sample { sample, .. } if !sample.is_deleted => self.0.on_waited(Waited::Ready),
            Event::Closed => self.0.on_waited(Waited::Closed),
            _ => Reaction::NONE,
        }
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        self.0.poll(now)
    }
}

/// Waits until all reachable robots know the declarations of this program.
///
/// The routers of the fleet, and the programs that have none, are asked for the time. A declaration takes the same way as
/// the question, and precedes it, so that a router that answers knows the declaration.
#[derive(Debug)]
pub struct EstablishedWait(Wait);

impl EstablishedWait {
    /// Creates the wait of a program, until `timeout` from `now`.
    pub fn new(place: &KeySpace, now: Instant, timeout: Duration) -> Self {
        let get = Get {
            target: Target::All,
            ..Get::new(place.own(None, CLOCK), timeout)
        };
        Self(Wait::new(Action::Get { id: QUERY, get }, now, timeout))
    }
}

impl Driver for EstablishedWait {
    type Item = std::convert::Infallible;
    type Output = Waited;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Ended { .. } if now >= self.0.deadline => self.0.on_waited(Waited::TimedOut),
            Event::Ended { .. } => self.0.on_waited(Waited::Ready),
            Event::Closed => self.0.on_waited(Waited::Closed),
            _ => Reaction::NONE,
        }
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        self.0.poll(now)
    }
}

/// Makes a program without a router visible to others, as a router does: it has a liveliness token, and tells the time.
#[derive(Debug)]
pub struct DirectPresence {
    clock_key: String,
    actions: VecDeque<Action>,
    questions: VecDeque<QueryId>,
    clock: MillisecondClock,
    is_closed: bool,
}

impl DirectPresence {
    /// Creates the presence of a program of the robot of `place`. `id` is the id of its Zenoh session, and `unix_ms` the
    /// time in milliseconds since 1970.
    pub fn new(place: &KeySpace, id: &str, unix_ms: u64, now: Instant) -> Self {
        let clock_key = place.own(Some(&place.robot), CLOCK);
        let token = Declaration::LivelinessToken {
            key: token(place, id),
        };
        let clock = Declaration::Queryable {
            key: clock_key.clone(),
            complete: true,
        };
        let declared = [(OWN_TOKEN, token), (OWN_CLOCK, clock)];
        Self {
            clock_key,
            actions: declared
                .map(|(id, declaration)| Action::Declare { id, declaration })
                .into(),
            questions: VecDeque::new(),
            clock: MillisecondClock::new(now, unix_ms),
            is_closed: false,
        }
    }
}

impl Driver for DirectPresence {
    type Item = std::convert::Infallible;
    type Output = ();

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Query { query, .. } => self.questions.push_back(query),
            Event::Closed => self.is_closed = true,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if let Some(action) = self.actions.pop_front() {
            return Step::Act(action);
        }
        let Some(query) = self.questions.pop_front() else {
            return Step::Wait(None);
        };
        let unix_s = self.clock.at(now) as f64 / 1000.0;
        let time = json!({ "unix_s": unix_s }).to_string();
        let answer = Answer::Reply {
            key: self.clock_key.clone(),
            payload: Payload::new(time, Encoding::JSON),
        };
        Step::Act(Action::Answer { query, answer })
    }
}

/// Returns the end of a timeout; a timeout beyond the range of the clock counts as a year.
fn deadline(now: Instant, timeout: Duration) -> Instant {
    const YEAR: Duration = Duration::from_secs(365 * 24 * 3600);
    now.checked_add(timeout).unwrap_or(now + YEAR)
}
