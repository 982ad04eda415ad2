//! Drives the reception of a large result. It waits while the robot cannot be reached, and asks the robot's router whether the program that
//! has the result still runs when nothing arrives.
use std::time::{Duration, Instant};

use super::{
    query::{Answers, GoalsQuery},
    result::LargeResult,
    state::{KnownGoal, PROGRAM_ENDED},
    topic,
};
use crate::{
    driver::{Action, Driver, Event, Id, Reaction, Step},
    message::{encoding::Encoding, payload::Payload},
    name::{key::KeySpace, topic::Topic, Name},
    storage::{Content, Files, Store},
    text::humanize,
    transfer::{files::UsesFiles, pull::TransferPull, ranges::Ranges, Fault, Progress},
};

/// How long nothing may arrive until the robot's router is asked.
const SILENT: Duration = Duration::from_secs(2);
/// The pause between two questions. After a restart of the router, its programs give their states again meanwhile.
const ASK_AGAIN: Duration = Duration::from_secs(3);
/// How long the router may take to answer.
const ANSWER: Duration = Duration::from_secs(3);
/// How many answers in a row say that nobody has the result.
const GONE_AFTER: u32 = 2;
/// How many answers in a row say that its program runs while not a single byte has arrived.
const MISSING_AFTER: u32 = 8;

/// A result that is being received.
#[derive(Debug)]
pub struct ResultPull {
    place: KeySpace,
    robot: Name,
    action: String,
    goal: String,
    result: LargeResult,
    pull: TransferPull,
    store: Store,
    question: Option<GoalsQuery>,
    ask_at: Instant,
    /// How much had arrived when that was last looked at.
    seen_bytes: u64,
    /// The number of answers in a row that say that nobody has the result.
    gone: u32,
    /// The number of answers in a row that say that its program runs.
    alive: u32,
    is_closed: bool,
}

/// Why there is no result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PullError {
    /// The session was closed, or the program has stopped it.
    Closed,
    /// It cannot be received. The reason follows "the goal is done, but".
    Unavailable(String),
}

impl ResultPull {
    /// Begins to receive the result of a goal, for a program of the robot of `place`.
    ///
    /// # Errors
    /// Returns [`PullError::Unavailable`] if the result is too large, or its description is not valid.
    pub fn new(
        place: &KeySpace,
        robot: &Name,
        action: &str,
        goal: &str,
        result: &LargeResult,
        now: Instant,
    ) -> Result<Self, PullError> {
        let wrong = |error: &dyn std::fmt::Display| PullError::Unavailable(error.to_string());
        let of_goal = Topic::new(&topic(action, goal)).map_err(|error| wrong(&error))?;
        let (id, offer) = result
            .offer(robot.clone(), of_goal)
            .map_err(|reason| wrong(&reason))?;
        let store = Store::in_memory(offer.size_bytes)
            .map_err(|error| wrong(&format!("its result cannot be received: {error}")))?;
        // The program that waits for the result has a timeout of its own.
        let forever = Duration::MAX;
        Ok(Self {
            pull: TransferPull::new(place, id, &offer, Ranges::default(), forever, now),
            place: place.clone(),
            robot: robot.clone(),
            action: action.to_owned(),
            goal: goal.to_owned(),
            result: result.clone(),
            store,
            question: None,
            ask_at: now + SILENT,
            seen_bytes: 0,
            gone: 0,
            alive: 0,
            is_closed: false,
        })
    }

    /// Returns how much has arrived.
    pub fn progress(&self) -> Progress {
        self.pull.progress()
    }

    /// Returns what a program waits for, for the text of a timeout.
    pub fn expected(&self) -> String {
        let Progress {
            received_bytes,
            size_bytes,
        } = self.progress();
        format!(
            "result of {} of {}, of which {} of {} have arrived,",
            self.action,
            self.robot,
            humanize::bytes(received_bytes),
            humanize::bytes(size_bytes)
        )
    }

    /// Stops it on behalf of the program.
    pub fn stop(&mut self) {
        self.is_closed = true;
    }

    fn store(&mut self, now: Instant) {
        while let Some(action) = self.pull.poll_file() {
            let event = self.store.perform(action);
            self.pull.on_file(now, event);
        }
        let received_bytes = self.pull.progress().received_bytes;
        if received_bytes != self.seen_bytes {
            self.seen_bytes = received_bytes;
            self.ask_at = now + SILENT;
            (self.gone, self.alive) = (0, 0);
        }
    }

    /// Handles the answer of the router. Returns the reason if there is no result.
    fn on_answers(&mut self, answers: &Answers, now: Instant) -> Option<String> {
        self.ask_at = now + ASK_AGAIN;
        if !answers.robots.contains(&self.robot) {
            // It cannot be reached, so nobody can know.
            (self.gone, self.alive) = (0, 0);
            return None;
        }
        let has_ended = |message: &crate::message::Message| {
            message.retained.is_some_and(|retained| retained.has_ended)
        };
        let size = humanize::bytes(self.result.size_bytes);
        let message = answers.goals.first();
        let known = message.and_then(KnownGoal::of);
        let why = match known.and_then(|known| known.state.transfer) {
            Some(result) if result == self.result => {
                if !message.is_some_and(has_ended) {
                    (self.gone, self.alive) = (0, self.alive + 1);
                    let is_missing = self.alive >= MISSING_AFTER && self.seen_bytes == 0;
                    return is_missing.then(|| {
                        format!(
                            "nothing of its result of {size} has arrived for a while: try again"
                        )
                    });
                }
                PROGRAM_ENDED
            }
            _ => "the robot does not know it any more",
        };
        (self.gone, self.alive) = (self.gone + 1, 0);
        (self.gone >= GONE_AFTER).then(|| format!("its result of {size} is lost: {why}"))
    }

    fn content(&mut self) -> Result<Payload, PullError> {
        let store = std::mem::replace(&mut self.store, Store::Memory(Vec::new()));
        match store.conclude(Ok(()), self.pull.held()).result {
            Ok(Content::Bytes(bytes)) => {
                let encoding = Encoding::new(self.result.encoding.clone());
                Ok(Payload::new(bytes, encoding))
            }
            Ok(Content::File(_)) => Err(PullError::Closed),
            Err(fault) => Err(self.failed(&fault)),
        }
    }

    fn failed(&self, fault: &Fault) -> PullError {
        let size = humanize::bytes(self.result.size_bytes);
        PullError::Unavailable(match fault {
            Fault::Unreadable(reason) => format!("its result of {size} is lost: {reason}"),
            fault => format!("its result of {size} has not arrived: {fault}"),
        })
    }
}

/// The ids of the pieces and those of the questions are the even and the odd ones.
fn marked(action: Action, mark: u64) -> Action {
    match action {
        Action::Get { id, get } => Action::Get {
            id: Id(id.0 * 2 + mark),
            get,
        },
        other => other,
    }
}

impl Driver for ResultPull {
    type Item = std::convert::Infallible;
    type Output = Result<Payload, PullError>;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        let (id, event) = match event {
            Event::Reply { id, reply } => {
                let original = Id(id.0 / 2);
                let event = Event::Reply {
                    id: original,
                    reply,
                };
                (id, event)
            }
            Event::Ended { id } => (id, Event::Ended { id: Id(id.0 / 2) }),
            Event::Closed => {
                self.is_closed = true;
                return Reaction::POLL;
            }
            _ => return Reaction::NONE,
        };
        // Neither of them delivers anything because of an event.
        let polls = match &mut self.question {
            _ if id.0 % 2 == 0 => self.pull.on_event(now, event).polls,
            Some(question) => question.on_event(now, event).polls,
            None => false,
        };
        match polls {
            true => Reaction::POLL,
            false => Reaction::NONE,
        }
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        loop {
            if self.is_closed {
                return Step::Finished(Err(PullError::Closed));
            }
            self.store(now);
            match self.question.as_mut().map(|question| question.poll(now)) {
                Some(Step::Act(action)) => return Step::Act(marked(action, 1)),
                Some(Step::Finished(answers)) => {
                    self.question = None;
                    if let Some(reason) = self.on_answers(&answers, now) {
                        return Step::Finished(Err(PullError::Unavailable(reason)));
                    }
                }
                None if self.ask_at <= now => {
                    let (place, robot) = (self.place.clone(), self.robot.as_str());
                    let question = GoalsQuery::new(place, robot, &self.action, &self.goal, ANSWER);
                    self.question = question.ok();
                    self.ask_at = now + ASK_AGAIN;
                    continue;
                }
                _ => {}
            }
            match self.pull.poll(now) {
                Step::Act(action) => return Step::Act(marked(action, 0)),
                Step::Deliver(_) => {}
                // The checksum is to be computed.
                Step::Wait(Some(until)) if until <= now => {}
                Step::Wait(until) => {
                    let asks = self.question.is_none().then_some(self.ask_at);
                    return Step::Wait(until.into_iter().chain(asks).min());
                }
                Step::Finished(Ok(())) => return Step::Finished(self.content()),
                Step::Finished(Err(fault)) => return Step::Finished(Err(self.failed(&fault))),
            }
        }
    }
}

#[cfg(test)]
mod tests;
