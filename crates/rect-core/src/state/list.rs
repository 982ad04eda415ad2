//! Drives the question for the last values of several topics, of one robot or of all.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::{
    page::{read, write, Page, Question},
    Position, STATE,
};
use crate::{
    driver::{Action, Driver, Event, Get, Id, Reaction, Sample, Step, Target},
    message::{urgency::Qos, Message},
    name::{
        key::{KeySpace, Selected},
        topic::Pattern,
        Name,
    },
};

/// The maximum number of values. Further ones are left out.
const MAX_VALUES: usize = 4096;
/// The maximum number of questions, which limits routers that always have more.
const MAX_QUESTIONS: u64 = 256;

/// The question for the last values of the topics that match a pattern. Finishes with them, as retained messages, when the routers have
/// answered.
#[derive(Debug)]
pub struct List {
    place: KeySpace,
    key: String,
    timeout: Duration,
    found: Vec<Message>,
    questions: VecDeque<(Option<Name>, Option<Position>)>,
    /// The number of questions that have not ended.
    open: usize,
    next: u64,
    is_closed: bool,
}

impl List {
    /// Creates the question of a program of the robot of `place`. `timeout`: how long a router may take.
    pub fn new(place: KeySpace, pattern: &Pattern, timeout: Duration) -> Self {
        let [Selected { key, .. }, _] = place.subscriptions(pattern);
        Self {
            key,
            questions: VecDeque::from([(pattern.robot().cloned(), None)]),
            found: Vec::new(),
            open: 0,
            next: 0,
            is_closed: false,
            place,
            timeout,
        }
    }

    fn on_reply(&mut self, sample: &Sample) {
        let robot = self.place.robot_of(&sample.key);
        let (Some(robot), Ok(page)) = (robot, read::<Page>(&sample.payload.bytes)) else {
            return;
        };
        for value in page.records {
            // The others are copies of values of other robots.
            if value.robot.is_none() && !value.is_forgotten && self.found.len() < MAX_VALUES {
                self.found.push(value.message(robot.clone()));
            }
        }
        if page.more {
            let since = Some(Position(page.run, page.at));
            self.questions.push_back((Some(robot), since));
        }
    }
}

impl Driver for List {
    type Item = std::convert::Infallible;
    type Output = Vec<Message>;

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

    fn poll(&mut self, _now: Instant) -> Step<Self::Item, Vec<Message>> {
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
            _ if self.open == 0 || is_done => Step::Finished(std::mem::take(&mut self.found)),
            _ => Step::Wait(None),
        }
    }
}
