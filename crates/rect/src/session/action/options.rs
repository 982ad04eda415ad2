//! Defines how a program declares an action.
use std::time::Duration;

use rect_core::action::server::Rules;

/// An action that a program declares with [`Robot::action`](crate::Robot::action): its name, and its rules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActionOptions {
    pub(super) action: String,
    pub(super) about: String,
    pub(super) rules: Rules,
}

impl ActionOptions {
    /// Describes an action of that name: 1 to 40 letters, digits, `_`, `-` and `.`.
    pub fn new(action: &str) -> Self {
        Self {
            action: action.to_owned(),
            about: String::new(),
            rules: Rules::default(),
        }
    }

    /// Sets the purpose of the action: at most 200 characters.
    #[must_use]
    pub fn about(self, about: &str) -> Self {
        let about = about.to_owned();
        Self { about, ..self }
    }

    /// Refuses a new goal while another one runs. Default: the new one preempts the other one, which is asked to end.
    #[must_use]
    pub fn refuse_when_busy(mut self) -> Self {
        self.rules.refuses = true;
        self
    }

    /// Cancels a goal when its client has been away for that long: its program has ended, or its robot cannot be reached. Default: 5 s.
    /// `None`: the goal is carried out without its client, too.
    #[must_use]
    pub fn lost_after(mut self, time: Option<Duration>) -> Self {
        self.rules.lost_after = time;
        self
    }
}

/// How a goal is started with [`Robot::start_with`](crate::Robot::start_with).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StartOptions {
    pub(super) id: Option<String>,
    pub(super) feedback_per_s: Option<f64>,
}

impl StartOptions {
    /// Creates the default options.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets the id of the goal: 1 to 40 letters, digits, `_`, `-` and `.`. Default: a random one. A goal that is started again with its id
    /// runs once.
    #[must_use]
    pub fn id(self, id: &str) -> Self {
        let id = Some(id.to_owned());
        Self { id, ..self }
    }

    /// Sets how often feedback is sent at most, per second: 0.1 to 50. Default: 10.
    #[must_use]
    pub fn feedback_per_s(mut self, rate: f64) -> Self {
        self.feedback_per_s = Some(rate);
        self
    }
}

impl From<&str> for ActionOptions {
    fn from(action: &str) -> Self {
        Self::new(action)
    }
}
