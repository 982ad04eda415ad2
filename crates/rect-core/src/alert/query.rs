//! Drives the question for the alerts of robots.
use std::{
    cmp::Reverse,
    time::{Duration, Instant},
};

use serde_json::json;

use super::{Alert, TOPICS};
use crate::{
    driver::{Action, Driver, Event, Get, Id, Reaction, Step, Target},
    message::{retained::Retained, urgency::Qos, Message},
    name::{key::KeySpace, topic::Topic, Name},
    state::{
        page::{read, write, Page, Question},
        STATE,
    },
};

const QUERY: Id = Id(0);

/// An alert of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotAlert {
    /// The robot.
    pub robot: Name,
    /// The topic, whose end is the name of the alert.
    pub topic: Topic,
    /// The problem.
    pub alert: Alert,
    /// How long ago it was raised, and whether the program that raised it has ended.
    pub retained: Retained,
}

impl RobotAlert {
    /// Reads the retained message of an alert; `None` if it is something else, or says that the alert was cleared.
    pub fn of(message: &Message) -> Option<Self> {
        let retained = message.retained.filter(|retained| !retained.is_forgotten)?;
        Some(Self {
            robot: message.sender.clone(),
            topic: message.topic.clone(),
            alert: Alert::read(&message.topic, &message.payload)?,
            retained,
        })
    }

    /// Sorts alerts: those of each robot together, the most important ones first, and then the oldest ones.
    pub fn sort(alerts: &mut [Self]) {
        alerts.sort_by_key(|one| {
            let (level, age) = (Reverse(one.alert.level), Reverse(one.retained.age));
            (one.robot.clone(), level, age)
        });
    }

    /// Returns the alert as a document for programs.
    pub fn to_json(&self) -> serde_json::Value {
        json!({
            "name": self.name(),
            "text": self.alert.text,
            "level": self.alert.level,
            "age_s": self.retained.age.as_secs_f64(),
            "program": self.alert.program,
            "has_ended": self.retained.has_ended,
        })
    }

    /// Returns the name, by which the alert is cleared.
    pub fn name(&self) -> &str {
        let topic = self.topic.as_str();
        topic.rsplit_once('/').map_or(topic, |(_, name)| name)
    }
}

/// Asks the routers of robots for their alerts. Robots that do not answer are left out.
#[derive(Debug)]
pub struct AlertsQuery {
    place: KeySpace,
    robot: Option<Name>,
    timeout: Duration,
    found: Vec<RobotAlert>,
    is_asked: bool,
    is_finished: bool,
    is_closed: bool,
}

impl AlertsQuery {
    /// Creates the question of a program of the robot of `place` for the alerts of `robot`, or of all robots (`None`).
    pub fn new(place: KeySpace, robot: Option<Name>, timeout: Duration) -> Self {
        Self {
            place,
            robot,
            timeout,
            found: Vec::new(),
            is_asked: false,
            is_finished: false,
            is_closed: false,
        }
    }

    fn on_page(&mut self, robot: &Name, page: Page) {
        for value in page.records {
            let alert = RobotAlert::of(&value.message(robot.clone()));
            self.found.extend(alert);
        }
    }
}

impl Driver for AlertsQuery {
    type Item = std::convert::Infallible;
    /// `None`: the session was closed.
    type Output = Option<Vec<RobotAlert>>;

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Reply {
                reply: Ok(sample), ..
            } => {
                let page = read(&sample.payload.bytes).ok();
                if let (Some(robot), Some(page)) = (self.place.robot_of(&sample.key), page) {
                    self.on_page(&robot, page);
                }
                Reaction::NONE
            }
            Event::Ended { .. } => {
                self.is_finished = true;
                Reaction::POLL
            }
            Event::Closed => {
                self.is_closed = true;
                Reaction::POLL
            }
            _ => Reaction::NONE,
        }
    }

    fn poll(&mut self, _now: Instant) -> Step<Self::Item, Self::Output> {
        if self.is_closed {
            return Step::Finished(None);
        }
        if self.is_finished {
            let mut found = std::mem::take(&mut self.found);
            RobotAlert::sort(&mut found);
            return Step::Finished(Some(found));
        }
        if std::mem::replace(&mut self.is_asked, true) {
            return Step::Wait(None);
        }
        let robot = self.robot.as_ref();
        let of = robot.map_or("*", Name::as_str);
        let question = Question::Since {
            by: None,
            adds: false,
            since: None,
            keys: vec![format!("{}/{of}/{TOPICS}", self.place.fleet)],
        };
        let get = Get {
            payload: Some(write(&question)),
            qos: Qos::REGISTRY,
            target: Target::All,
            ..Get::new(self.place.own(robot, STATE), self.timeout)
        };
        Step::Act(Action::Get { id: QUERY, get })
    }
}
