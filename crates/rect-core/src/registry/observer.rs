//! Drives the subscription to events of robots, programs, links and the router, and the observation of the router's links.
use std::{collections::VecDeque, time::Instant};

use super::{
    connection::{Connection, Event as ConnectionEvent, Link, Links, Presence},
    programs::Programs,
};
use crate::{
    catalogue::{
        token::{self, Token},
        Instance,
    },
    driver::{Action, Declaration, Driver, Event, Get, Id, Reaction, Sample, Step},
    message::payload::Payload,
    name::key::KeySpace,
    session::peers::{self, TIMEOUT},
};

const LINKS: Id = Id(0);
const PEERS: Id = Id(1);
const CONNECTIONS: Id = Id(2);
const QUERY: Id = Id(3);
const PROGRAMS: Id = Id(4);

/// Observes robots, programs, links and the router. Delivers their events, beginning with the robots, programs and links that exist.
#[derive(Debug)]
pub struct Observer {
    place: KeySpace,
    is_direct: bool,
    actions: VecDeque<Action>,
    presence: Presence,
    programs: Programs,
    links: Links,
    is_closed: bool,
}

impl Observer {
    /// Creates the observer of the program `own`. `is_direct`: the program has links of its own and no router.
    pub fn new(place: KeySpace, own: Instance, is_direct: bool) -> Self {
        let declare = |id, declaration| Action::Declare { id, declaration };
        let key = peers::tokens(&place, None);
        let programs = Declaration::LivelinessSubscriber {
            key: token::tokens(&place, None),
        };
        let mut actions = VecDeque::from([
            declare(LINKS, Declaration::LinkListener),
            declare(PEERS, Declaration::LivelinessSubscriber { key }),
            declare(PROGRAMS, programs),
        ]);
        if !is_direct {
            actions.extend(follow(&place));
        }
        Self {
            place,
            is_direct,
            actions,
            presence: Presence::default(),
            programs: Programs::new(own),
            links: Links::default(),
            is_closed: false,
        }
    }

    fn on_token(&mut self, sample: &Sample) -> Option<ConnectionEvent> {
        let robot = self.place.robot_of(&sample.key);
        let robot = robot.filter(|robot| *robot != self.place.robot)?;
        let id = sample.key.rsplit('/').next()?;
        if sample.is_deleted {
            self.presence.on_down(&robot, id)
        } else {
            self.presence.on_up(&robot, id)
        }
    }

    fn on_link(&self, up: bool, method: String, address: String) -> ConnectionEvent {
        let link = Link {
            method,
            address,
            robot: None,
        };
        match (up, self.is_direct) {
            (true, true) => ConnectionEvent::LinkUp(link),
            (false, true) => ConnectionEvent::LinkDown(link),
            (true, false) => ConnectionEvent::RouterUp,
            (false, false) => ConnectionEvent::RouterDown,
        }
    }
}

impl Driver for Observer {
    type Item = ConnectionEvent;
    type Output = ();

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Sample { id: PEERS, sample } => {
                Reaction::deliver(self.on_token(&sample).into_iter().collect())
            }
            Event::Sample {
                id: PROGRAMS,
                sample,
            } => {
                let token = Token::parse(&self.place, &sample.key);
                let event =
                    token.and_then(|token| self.programs.on_token(token, !sample.is_deleted));
                Reaction::deliver(event.into_iter().collect())
            }
            Event::Sample { sample, .. }
            | Event::Reply {
                id: QUERY,
                reply: Ok(sample),
            } => match connections(&sample.payload) {
                Some(connections) => Reaction::deliver(self.links.on_connections(&connections)),
                None => Reaction::NONE,
            },
            Event::Link {
                up,
                method,
                address,
            } => Reaction::deliver(vec![self.on_link(up, method, address)]),
            Event::Closed => {
                self.is_closed = true;
                Reaction::POLL
            }
            _ => Reaction::NONE,
        }
    }

    fn poll(&mut self, _now: Instant) -> Step<Self::Item, Self::Output> {
        poll(&mut self.actions, self.is_closed)
    }
}

/// Observes the links of this robot's router. Delivers each report of its registry. Without a registry there is none.
#[derive(Debug)]
pub struct RouterObserver {
    actions: VecDeque<Action>,
    is_closed: bool,
}

impl RouterObserver {
    /// Creates the observer of a program of the robot of `place`.
    pub fn new(place: &KeySpace) -> Self {
        Self {
            actions: follow(place).into(),
            is_closed: false,
        }
    }
}

impl Driver for RouterObserver {
    type Item = Vec<Connection>;
    type Output = ();

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Sample { sample, .. }
            | Event::Reply {
                reply: Ok(sample), ..
            } => Reaction::deliver(connections(&sample.payload).into_iter().collect()),
            Event::Closed => {
                self.is_closed = true;
                Reaction::POLL
            }
            _ => Reaction::NONE,
        }
    }

    fn poll(&mut self, _now: Instant) -> Step<Self::Item, Self::Output> {
        poll(&mut self.actions, self.is_closed)
    }
}

/// Returns the actions that follow the connections of the robot's router.
fn follow(place: &KeySpace) -> [Action; 2] {
    let key = place.own(Some(&place.robot), "connections");
    let get = Get::new(key.clone(), TIMEOUT);
    let declaration = Declaration::Subscriber { key };
    let id = CONNECTIONS;
    [
        Action::Declare { id, declaration },
        Action::Get { id: QUERY, get },
    ]
}

/// Reads a report of the registry; `None` if it is not one.
fn connections(payload: &Payload) -> Option<Vec<Connection>> {
    serde_json::from_slice(&payload.bytes).ok()
}

fn poll<I>(actions: &mut VecDeque<Action>, is_closed: bool) -> Step<I, ()> {
    match actions.pop_front() {
        _ if is_closed => Step::Finished(()),
        Some(action) => Step::Act(action),
        None => Step::Wait(None),
    }
}
