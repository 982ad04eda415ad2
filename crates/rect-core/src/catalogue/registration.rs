//! Drives the registration of a program at its robot's router.
use std::time::{Duration, Instant};

use serde::Deserialize;

use super::{Program, REGISTER};
use crate::{
    driver::{Action, Driver, Event, Get, Id, Reaction, Step},
    message::{
        encoding::Encoding,
        payload::Payload,
        request::{error_from_payload, is_timeout},
        urgency::Qos,
    },
    name::key::KeySpace,
};

/// The timeout. The router is on the same computer, but it may wait for the answer of another program that serves a topic.
const TIMEOUT: Duration = Duration::from_secs(3);
const QUERY: Id = Id(0);

/// The registration of a program at its router.
#[derive(Debug)]
pub struct Registration {
    get: Option<Get>,
    registered: Option<Registered>,
}

/// How a registration ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Registered {
    /// The router keeps it, and may have a warning for the program.
    Accepted(Option<String>),
    /// No router keeps a catalogue, as stock routers do, or it does not answer. Then nobody refuses a second server of a topic. The
    /// presence of the program repeats the registration.
    Unanswered,
    /// The router refuses it, for this reason.
    Refused(String),
    /// The session is closed.
    Closed,
}

/// The router's answer.
#[derive(Deserialize)]
struct AnswerDocument {
    #[serde(default)]
    warning: Option<String>,
}

impl Registration {
    /// Creates the registration of a program of the robot of `place`.
    pub fn new(place: &KeySpace, program: &Program) -> Self {
        Self {
            get: Some(get(place, program)),
            registered: None,
        }
    }
}

/// Returns the query that registers a program.
pub(super) fn get(place: &KeySpace, program: &Program) -> Get {
    Get {
        payload: Some(Payload::new(program.to_json(), Encoding::JSON)),
        qos: Qos::REGISTRY,
        ..Get::new(place.own(Some(&place.robot), REGISTER), TIMEOUT)
    }
}

/// Returns the meaning of the router's reply.
pub(super) fn registered(reply: Result<Payload, Payload>) -> Registered {
    match reply {
        Ok(answer) => {
            let answer: Option<AnswerDocument> = serde_json::from_slice(&answer.bytes).ok();
            Registered::Accepted(answer.and_then(|answer| answer.warning))
        }
        Err(error) => match error_from_payload(error) {
            (robot, error) if is_timeout(robot.as_ref(), &error) => Registered::Unanswered,
            (_, error) => Registered::Refused(String::from_utf8_lossy(&error.bytes).into_owned()),
        },
    }
}

impl Driver for Registration {
    type Item = std::convert::Infallible;
    type Output = Registered;

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        let registered = match event {
            Event::Reply { reply, .. } => registered(reply.map(|sample| sample.payload)),
            Event::Ended { .. } => Registered::Unanswered,
            Event::Closed => Registered::Closed,
            _ => return Reaction::NONE,
        };
        self.registered.get_or_insert(registered);
        Reaction::POLL
    }

    fn poll(&mut self, _now: Instant) -> Step<Self::Item, Registered> {
        if let Some(get) = self.get.take() {
            return Step::Act(Action::Get { id: QUERY, get });
        }
        match &self.registered {
            Some(registered) => Step::Finished(registered.clone()),
            None => Step::Wait(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{catalogue::Instance, name::Name};

    fn registration() -> Registration {
        let name = |text: &str| Name::new(text).expect("valid name");
        let (fleet, robot) = (name("rect"), name("wombat-1"));
        let program = Program {
            name: None,
            instance: Instance(1),
            services: Vec::new(),
        };
        Registration::new(&KeySpace { fleet, robot }, &program)
    }

    fn finished(
        events: impl IntoIterator<Item = Event>,
    ) -> Step<std::convert::Infallible, Registered> {
        let (mut registration, now) = (registration(), Instant::now());
        assert!(matches!(
            registration.poll(now),
            Step::Act(Action::Get { .. })
        ));
        assert_eq!(registration.poll(now), Step::Wait(None));
        for event in events {
            let _ = registration.on_event(now, event);
        }
        registration.poll(now)
    }

    fn error(text: &'static str) -> Event {
        let reply = Err(Payload::new(text, Encoding::TEXT));
        Event::Reply { id: QUERY, reply }
    }

    #[test]
    fn refusal_of_the_router_is_the_outcome() {
        let events = [error("served already"), Event::Ended { id: QUERY }];
        let refused = Registered::Refused("served already".to_owned());
        assert_eq!(finished(events), Step::Finished(refused));
    }

    #[test]
    fn registration_without_a_catalogue_is_not_refused() {
        for event in [Event::Ended { id: QUERY }, error("Timeout")] {
            assert_eq!(finished([event]), Step::Finished(Registered::Unanswered));
        }
    }
}
