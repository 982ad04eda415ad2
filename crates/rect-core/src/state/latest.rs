//! Drives the question for the last value of a topic of one robot.
use std::time::{Duration, Instant};

use super::{
    page::{read, write, Order, Page, Question},
    program::order_to,
    STATE,
};
use crate::{
    driver::{Action, Driver, Event, Get, Id, Reaction, Step},
    message::{retained::value::Value, urgency::Qos},
    name::{key::KeySpace, topic::Topic, Name},
};

/// The timeout of the question to the own router.
const TIMEOUT: Duration = Duration::from_secs(2);
const OWN: Id = Id(0);
const OTHER: Id = Id(1);

/// The question for the last value of a topic. The own router knows it if a program of the robot subscribes to the topic; otherwise the
/// router of the other robot is asked.
#[derive(Debug)]
pub struct Latest {
    place: KeySpace,
    robot: Name,
    topic: Topic,
    timeout: Duration,
    next: Next,
}

#[derive(Debug)]
enum Next {
    Ask(Id),
    Wait,
    Finish(Option<Value>),
}

impl Latest {
    /// Creates the question of a program of the robot of `place`. `timeout`: how long the other robot may take.
    pub fn new(place: KeySpace, robot: Name, topic: Topic, timeout: Duration) -> Self {
        Self {
            place,
            robot,
            topic,
            timeout,
            next: Next::Ask(OWN),
        }
    }

    fn on_page(&mut self, id: Id, page: Page) {
        let is_own = self.robot == self.place.robot;
        let name = if is_own { "" } else { self.robot.as_str() };
        let is_complete = page.complete.iter().any(|(robot, _)| robot == name);
        let is_of_robot = |value: &Value| match (&value.robot, id) {
            (None, OWN) => is_own,
            (None, _) => true,
            (Some(robot), OWN) => *robot == self.robot,
            (Some(_), _) => false,
        };
        let is_asked = |value: &Value| value.topic == self.topic && is_of_robot(value);
        let value = page
            .records
            .into_iter()
            .find(|value| is_asked(value) && !value.is_forgotten);
        if value.is_some() || is_complete || is_own || id == OTHER {
            let robot = self.robot.clone();
            self.next = Next::Finish(value.map(|value| Value {
                robot: Some(robot),
                ..value
            }));
        }
    }

    fn question(&self, id: Id) -> Get {
        let robot = match id {
            OWN => Some(&self.robot),
            _ => None,
        };
        let key = self.place.service(Some(&self.robot), &self.topic);
        match robot {
            Some(_) => order_to(&self.place, &Order::Latest { key }, TIMEOUT),
            None => {
                let question = Question::Since {
                    by: None,
                    adds: false,
                    since: None,
                    keys: vec![key],
                };
                Get {
                    payload: Some(write(&question)),
                    qos: Qos::REGISTRY,
                    ..Get::new(self.place.own(Some(&self.robot), STATE), self.timeout)
                }
            }
        }
    }
}

impl Driver for Latest {
    type Item = std::convert::Infallible;
    type Output = Option<Value>;

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match (&self.next, event) {
            (_, Event::Closed) => self.next = Next::Finish(None),
            (Next::Wait, Event::Reply { id, reply }) => {
                let page = reply
                    .ok()
                    .and_then(|sample| read(&sample.payload.bytes).ok());
                if let Some(page) = page {
                    self.on_page(id, page);
                }
            }
            (Next::Wait, Event::Ended { id: OWN }) => self.next = Next::Ask(OTHER),
            (Next::Wait, Event::Ended { .. }) => self.next = Next::Finish(None),
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, _now: Instant) -> Step<Self::Item, Option<Value>> {
        match &mut self.next {
            Next::Ask(id) => {
                let id = *id;
                self.next = Next::Wait;
                let get = self.question(id);
                Step::Act(Action::Get { id, get })
            }
            Next::Wait => Step::Wait(None),
            Next::Finish(value) => Step::Finished(value.take()),
        }
    }
}
