//! Drives the question for goals, which also tells which robots have answered: one that has does not know other goals, and one that has
//! not may carry them out.
use std::time::{Duration, Instant};

use super::topic;
use crate::{
    driver::{Driver, Event, Reaction, Step},
    message::Message,
    name::{
        key::KeySpace,
        topic::{Pattern, TopicError},
        Name,
    },
    state::list::List,
};

/// The question for goals.
#[derive(Debug)]
pub struct GoalsQuery {
    place: KeySpace,
    list: List,
    answered: Vec<Name>,
}

/// The goals that robots know.
#[derive(Clone, Debug, Default)]
pub struct Answers {
    /// The robots that have answered.
    pub robots: Vec<Name>,
    /// The states of their goals, as retained messages.
    pub goals: Vec<Message>,
}

impl GoalsQuery {
    /// Creates the question of a program of the robot of `place` for goals of `robot`. `*` stands for all robots, actions and goals.
    /// `timeout`: how long a router may take.
    ///
    /// # Errors
    /// Returns a [`TopicError`] if there is no such robot, action or goal.
    pub fn new(
        place: KeySpace,
        robot: &str,
        action: &str,
        goal: &str,
        timeout: Duration,
    ) -> Result<Self, TopicError> {
        let pattern = Pattern::new(&format!("{robot}/{}", topic(action, goal)))?;
        Ok(Self {
            list: List::new(place.clone(), &pattern, timeout),
            answered: Vec::new(),
            place,
        })
    }
}

impl Driver for GoalsQuery {
    type Item = std::convert::Infallible;
    type Output = Answers;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        if let Event::Reply {
            reply: Ok(sample), ..
        } = &event
        {
            let robot = self.place.robot_of(&sample.key);
            let is_new = |robot: &Name| !self.answered.contains(robot);
            self.answered.extend(robot.filter(is_new));
        }
        self.list.on_event(now, event)
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Answers> {
        match self.list.poll(now) {
            Step::Finished(goals) => Step::Finished(Answers {
                robots: std::mem::take(&mut self.answered),
                goals,
            }),
            Step::Act(action) => Step::Act(action),
            Step::Deliver(never) => match never {},
            Step::Wait(until) => Step::Wait(until),
        }
    }
}
