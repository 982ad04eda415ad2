//! Decides for a program that follows a goal, which it or another one has started.
use std::time::{Duration, Instant};

use super::{
    short,
    state::{Feedback, GoalState, Phase, PROGRAM_ENDED},
};
use crate::{
    message::{retained::Retained, Message},
    name::Name,
    registry::connection::Event,
    stop::MARKED_WITHIN,
};

/// The pause between two questions whether somebody carries out the goal. It is lost if two in a row say that nobody does: after a restart
/// of the robot's router its program gives the state again.
const ASK_AGAIN: Duration = Duration::from_secs(3);
/// How long after the return of a robot it is asked.
const AFTER_RETURN: Duration = Duration::from_secs(1);
/// How long nothing may arrive from a program without a name, whose end is not an event, until its robot is asked.
const QUIET: Duration = Duration::from_secs(10);

/// A goal, as far as a client knows.
#[derive(Debug)]
pub struct ActionRun {
    robot: Name,
    state: GoalState,
    feedback: Option<Feedback>,
    /// Since when the phase is what it is.
    since: Instant,
    /// Since when the robot cannot be reached.
    unreachable_since: Option<Instant>,
    /// When the robot is asked for the state.
    ask_at: Option<Instant>,
    /// The same, because nothing has arrived from a program without a name.
    quiet_at: Option<Instant>,
    /// Whether nobody seems to carry it out.
    is_suspected: bool,
}

impl ActionRun {
    /// Creates what a client knows of a goal of `robot` that was accepted.
    pub fn new(robot: Name, now: Instant) -> Self {
        Self {
            robot,
            state: GoalState::new(Phase::Waiting),
            feedback: None,
            since: now,
            unreachable_since: None,
            // Its router may not know the state yet.
            ask_at: Some(now + ASK_AGAIN),
            quiet_at: None,
            is_suspected: false,
        }
    }

    /// Creates a goal that was refused.
    pub fn refused(robot: Name, reason: &str, now: Instant) -> Self {
        let mut run = Self::new(robot, now);
        run.end(Phase::Refused, reason, now);
        run
    }

    /// Handles a message with the state. Returns whether something has changed.
    pub fn on_message(&mut self, message: &Message, now: Instant) -> bool {
        // One of a recording says nothing about this goal.
        if self.has_ended() || message.replayed {
            return false;
        }
        let retained = message.retained.unwrap_or_default();
        let state = match retained.is_forgotten {
            true => None,
            false => GoalState::read(&message.payload).ok(),
        };
        match state {
            Some(state) if state.phase.is_end() || !retained.has_ended => {
                self.take(state, retained.age, now)
            }
            _ => {
                self.ask_within(ASK_AGAIN, now);
                false
            }
        }
    }

    /// Handles the answer to the question that [`asks`](Self::asks) asked: the state, `None` if the robot does not know the goal.
    /// Returns whether something has changed.
    pub fn on_answer(&mut self, message: Option<&Message>, now: Instant) -> bool {
        if self.has_ended() {
            return false;
        }
        let message = message.filter(|message| !message.is_forgotten());
        let retained = message.and_then(|message| message.retained);
        let Retained { age, has_ended, .. } = retained.unwrap_or_default();
        let state = message.and_then(|message| GoalState::read(&message.payload).ok());
        let reason = match state {
            Some(state) if state.phase.is_end() || !has_ended => return self.take(state, age, now),
            Some(_) => PROGRAM_ENDED,
            None => "the robot does not know it any more",
        };
        if self.unreachable_since.is_some() {
            return false;
        }
        if std::mem::replace(&mut self.is_suspected, true) {
            self.end(Phase::Lost, reason, now);
            return true;
        }
        self.ask_at = Some(now + ASK_AGAIN);
        false
    }

    /// Handles that the robot did not answer.
    pub fn on_no_answer(&mut self, now: Instant) {
        self.ask_within(ASK_AGAIN, now);
    }

    /// Handles feedback.
    pub fn on_feedback(&mut self, feedback: Feedback, now: Instant) {
        if !self.has_ended() {
            if self.state.phase == Phase::Waiting {
                // The state that says so is under way: only a handler that runs gives feedback.
                self.state.phase = Phase::Running;
                self.since = now;
            }
            self.feedback = Some(feedback);
            self.on_sign_of_life(now);
        }
    }

    /// Handles that robots and programs come and go. Returns whether something has changed.
    pub fn on_event(&mut self, event: &Event, now: Instant) -> bool {
        if self.has_ended() {
            return false;
        }
        match event {
            Event::PeerDown { robot } if *robot == self.robot => {
                self.unreachable_since.get_or_insert(now);
                // Nobody can know now.
                (self.ask_at, self.quiet_at, self.is_suspected) = (None, None, false);
                true
            }
            Event::PeerUp { robot } if *robot == self.robot => {
                self.ask_within(AFTER_RETURN, now);
                self.unreachable_since.take().is_some()
            }
            Event::ProgramDown { robot, .. } if *robot == self.robot => {
                if self.unreachable_since.is_none() {
                    self.ask_within(MARKED_WITHIN, now);
                }
                false
            }
            _ => false,
        }
    }

    /// Returns whether the robot's router is to be asked for the state now.
    pub fn asks(&mut self, now: Instant) -> bool {
        let (asks, is_quiet) = (&mut self.ask_at, &mut self.quiet_at);
        let due = [asks, is_quiet].map(|at| at.take_if(|at| *at <= now).is_some());
        due.contains(&true)
    }

    /// Returns when to call [`asks`](Self::asks).
    pub fn deadline(&self) -> Option<Instant> {
        self.ask_at.into_iter().chain(self.quiet_at).min()
    }

    /// Returns what is known about the goal.
    pub fn state(&self) -> &GoalState {
        &self.state
    }

    /// Returns the newest feedback.
    pub fn feedback(&self) -> Option<&Feedback> {
        self.feedback.as_ref()
    }

    /// Returns since when the goal is in this phase, by this computer's clock.
    pub fn since(&self) -> Instant {
        self.since
    }

    /// Returns since when the robot cannot be reached. The goal goes on, unless its rules say otherwise.
    pub fn unreachable_since(&self) -> Option<Instant> {
        self.unreachable_since.filter(|_| !self.has_ended())
    }

    /// Returns whether the goal has ended.
    pub fn has_ended(&self) -> bool {
        self.state.phase.is_end()
    }

    /// Takes over a state, which came to the router `age` ago.
    fn take(&mut self, state: GoalState, age: Duration, now: Instant) -> bool {
        self.on_sign_of_life(now);
        if state == self.state {
            return false;
        }
        if state.phase != self.state.phase {
            self.since = now.checked_sub(age).unwrap_or(now);
        }
        self.state = state;
        if self.has_ended() {
            (self.ask_at, self.quiet_at) = (None, None);
        }
        true
    }

    fn on_sign_of_life(&mut self, now: Instant) {
        self.is_suspected = false;
        self.quiet_at = self.state.program.is_empty().then(|| now + QUIET);
    }

    fn ask_within(&mut self, time: Duration, now: Instant) {
        let at = now + time;
        self.ask_at = Some(self.ask_at.map_or(at, |before| before.min(at)));
    }

    fn end(&mut self, phase: Phase, reason: &str, now: Instant) {
        self.state.phase = phase;
        self.state.reason = short(reason);
        self.since = now;
        (self.ask_at, self.quiet_at) = (None, None);
    }
}
