//! Drives questions to the registry of a router, and changes of its named connections (docs/reference/registry.md); parses the
//! questions that a registry receives ([`selector`]).
pub mod catalogue_query;
pub mod connection;
pub mod named_connection;
pub mod observer;
pub mod programs;
pub mod selector;
pub mod servers_query;
pub mod topics;
pub mod usage;

use std::time::{Duration, Instant};

use self::named_connection::CONFIG;
use crate::{
    driver::{Action, Driver, Event, Get, Id, Reaction, Step},
    message::{
        encoding::Encoding,
        payload::Payload,
        request::{error_from_payload, is_timeout},
        urgency::Qos,
    },
    name::{key::KeySpace, Name},
    session::peers::{PeersQuery, TIMEOUT},
    text::{display, humanize},
};

const QUERY: Id = Id(100);

/// A question to the registry of one robot. Finishes with the JSON of the answer.
#[derive(Debug)]
pub struct RegistryQuery {
    place: KeySpace,
    robot: Name,
    question: String,
    get: Option<Get>,
    state: State,
}

#[derive(Debug)]
enum State {
    Asking,
    /// There is no answer: the error names the reachable robots.
    AskingPeers(PeersQuery),
    Answered(Result<Payload, RegistryError>),
}

/// Why there is no answer to a question.
#[derive(Clone, Debug, PartialEq)]
pub enum RegistryError {
    /// The router rejects the question. The payload is the reason, a text.
    Rejected(Payload),
    /// The router did not answer in time.
    TimedOut {
        /// The expected answer, for the text of the error.
        expected: String,
    },
    /// No router of that robot answers the question.
    NoService {
        /// Description of the question, for the text of the error.
        service: String,
        /// The robots that are reachable.
        available: Vec<Name>,
    },
    /// The session is closed.
    Closed,
}

impl RegistryQuery {
    /// Creates a question such as `connections` to the router of `robot`. An empty `filter` selects everything.
    pub fn new(place: KeySpace, robot: Name, question: &str, filter: &str) -> Self {
        Self::with_payload(place, robot, question, filter, None)
    }

    /// Creates a change of the named connections of the router of `robot`: `action` is
    /// [`ADD`](named_connection::ADD) or [`REMOVE`](named_connection::REMOVE).
    pub fn change(place: KeySpace, robot: Name, action: &str, argument: String) -> Self {
        let parameters = format!("{action};by={}", place.robot);
        let payload = Payload::new(argument, Encoding::BYTES);
        Self::with_payload(place, robot, CONFIG, &parameters, Some(payload))
    }

    fn with_payload(
        place: KeySpace,
        robot: Name,
        question: &str,
        parameters: &str,
        payload: Option<Payload>,
    ) -> Self {
        let key = place.own(Some(&robot), question);
        let selector = match parameters {
            "" => key,
            _ => format!("{key}?{parameters}"),
        };
        let get = Get {
            payload,
            qos: Qos::REGISTRY,
            ..Get::new(selector, TIMEOUT)
        };
        Self {
            place,
            robot,
            question: question.to_owned(),
            get: Some(get),
            state: State::Asking,
        }
    }

    fn on_reply(&mut self, reply: Result<Payload, Payload>) {
        if !matches!(self.state, State::Asking) {
            return;
        }
        self.state = State::Answered(match reply {
            // Answers of the registry are JSON; it does not say so, which saves bytes on the air. Its errors are text.
            Ok(answer) => Ok(Payload {
                encoding: Encoding::JSON,
                ..answer
            }),
            Err(error) => {
                let (robot, error) = error_from_payload(error);
                Err(if is_timeout(robot.as_ref(), &error) {
                    RegistryError::TimedOut {
                        expected: format!(
                            "reply from the router of {} about {}",
                            self.robot, self.question
                        ),
                    }
                } else {
                    RegistryError::Rejected(error)
                })
            }
        });
    }
}

impl Driver for RegistryQuery {
    type Item = std::convert::Infallible;
    type Output = Result<Payload, RegistryError>;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Reply { id: QUERY, reply } => self.on_reply(reply.map(|sample| sample.payload)),
            Event::Ended { id: QUERY } if matches!(self.state, State::Asking) => {
                self.state = State::AskingPeers(PeersQuery::new(self.place.clone()));
            }
            Event::Closed => {
                if !matches!(self.state, State::Answered(_)) {
                    self.state = State::Answered(Err(RegistryError::Closed));
                }
            }
            event => {
                if let State::AskingPeers(peers) = &mut self.state {
                    return peers.on_event(now, event);
                }
            }
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        if let Some(get) = self.get.take() {
            return Step::Act(Action::Get { id: QUERY, get });
        }
        match &mut self.state {
            State::Asking => Step::Wait(None),
            State::Answered(answer) => Step::Finished(answer.clone()),
            State::AskingPeers(peers) => match peers.poll(now) {
                Step::Finished(available) => {
                    let service = service(&self.question);
                    Step::Finished(Err(RegistryError::NoService { service, available }))
                }
                Step::Act(action) => Step::Act(action),
                Step::Deliver(never) => match never {},
                Step::Wait(until) => Step::Wait(until),
            },
        }
    }
}

/// Describes a question for the error that no router answers it.
fn service(question: &str) -> String {
    if question == CONFIG {
        "changes of connections (the router's access control must allow them, and its settings must name a connections \
         file)"
            .to_owned()
    } else {
        format!("the registry ({question})")
    }
}

/// Describes an error reply to a question to several registries, of which one does not spoil the replies of the others. `who` is the
/// robot, or `a robot` if it is not known.
pub fn error_reply(who: &str, timeout: Duration, reply: &Payload) -> String {
    if is_timeout(None, reply) {
        let timeout = humanize::duration(timeout);
        return format!("{who} has not replied within {timeout}; its link may be silent");
    }
    let reason = String::from_utf8_lossy(&reply.bytes);
    format!("{who} replied with an error: {}", display::line(&reason))
}
