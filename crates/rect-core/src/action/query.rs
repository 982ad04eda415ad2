//! Drives the question for goals, of one robot or of all. It also tells which robots have answered: one that has does not know other goals,
//! and one that has not may carry them out.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::topic;
use crate::{
    driver::{Action, Driver, Event, Get, Id, Reaction, Sample, Step, Target},
    message::{urgency::Qos, Message},
    name::{
        key::{KeySpace, Selected},
        topic::{Pattern, TopicError},
        Name,
    },
    state::{
        page::{read, write, Page, Question},
        Position, STATE,
    },
};

/// The maximum number of goals. Further ones are left out.
const MAX_GOALS: usize = 4096;
/// The maximum number of questions, which limits routers that always have more.
const MAX_QUESTIONS: u64 = 256;

/// The question for goals. Finishes when the routers have answered.
#[derive(Debug)]
pub struct GoalsQuery {
    place: KeySpace,
    key: String,
    timeout: Duration,
    answers: Answers,
    questions: VecDeque<(Option<Name>, Option<Position>)>,
    /// The number of questions that have not ended.
    open: usize,
    next: u64,
    is_closed: bool,
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
        let [Selected { key, .. }, _] = place.subscriptions(&pattern);
        Ok(Self {
            key,
            questions: VecDeque::from([(pattern.robot().cloned(), None)]),
            answers: Answers::default(),
            open: 0,
            next: 0,
            is_closed: false,
            place,
            timeout,
        })
    }

    fn on_reply(&mut self, sample: &Sample) {
        let robot = self.place.robot_of(&sample.key);
        let (Some(robot), Ok(page)) = (robot, read::<Page>(&sample.payload.bytes)) else {
            return;
        };
        let Answers { robots, goals } = &mut self.answers;
        if !robots.contains(&robot) {
            robots.push(robot.clone());
        }
        for value in page.records {
            // The others are copies of values of other robots.
            if value.robot.is_none() && !value.is_forgotten && goals.len() < MAX_GOALS {
                goals.push(value.message(robot.clone()));
            }
        }
        if page.more {
            let since = Some(Position(page.run, page.at));
            self.questions.push_back((Some(robot), since));
        }
    }
}

impl Driver for GoalsQuery {
    type Item = std::convert::Infallible;
    type Output = Answers;

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Reply {
                reply: Ok(sample), ..
            } => self.on_reply(&sample),
            Event::Ended { .. } => self.open = self.open.saturating_sub(1),
            Event::Closed => self.is_closed = true,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, _now: Instant) -> Step<Self::Item, Answers> {
        let is_done = self.is_closed || self.next >= MAX_QUESTIONS;
        match self.questions.pop_front() {
            Some((robot, since)) if !is_done => {
                let question = Question::Since {
                    by: None,
                    adds: false,
                    since,
                    keys: vec![self.key.clone()],
                };
                let get = Get {
                    payload: Some(write(&question)),
                    qos: Qos::REGISTRY,
                    target: Target::All,
                    ..Get::new(self.place.own(robot.as_ref(), STATE), self.timeout)
                };
                let id = Id(self.next);
                self.next += 1;
                self.open += 1;
                Step::Act(Action::Get { id, get })
            }
            _ if self.open == 0 || is_done => Step::Finished(std::mem::take(&mut self.answers)),
            _ => Step::Wait(None),
        }
    }
}
