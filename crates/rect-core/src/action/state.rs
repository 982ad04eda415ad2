//! Defines what is known about a goal, which the robot's router keeps, and the feedback of a goal.
use std::{fmt, time::Duration};

use ciborium::Value;
use serde::{Deserialize, Serialize};

use super::{cbor, null, of_topic, result::LargeResult, short, to_payload, MAX_VALUE};
use crate::{
    message::{payload::Payload, Message},
    name::Name,
};

/// Why a goal is lost whose program has ended.
pub(super) const PROGRAM_ENDED: &str = "the program that carried it out has ended";

/// The maximum size of a goal that is repeated in its state, in bytes.
const MAX_GOAL: usize = 2 << 10;
/// The maximum size of a state, in bytes.
const MAX_BYTES: usize = MAX_VALUE + (8 << 10);
/// The maximum length of the names of a client and a program, in characters.
const MAX_NAME: usize = 120;

/// How far a goal has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// It waits for the end of another goal.
    Waiting,
    /// It is being carried out.
    Running,
    /// It is being carried out, and was asked to end.
    Cancelling,
    /// It was carried out.
    Done,
    /// It was not accepted, and never began.
    Refused,
    /// Its program has failed at it.
    Failed,
    /// Somebody has cancelled it.
    Cancelled,
    /// A newer goal has taken its place.
    Preempted,
    /// The program that carried it out has ended, so that nobody knows how far it came.
    Lost,
}

/// A goal, as its robot's router keeps it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoalState {
    /// How far it has come.
    pub phase: Phase,
    /// Why it has ended, or is asked to; empty if that is clear.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// The result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub result: Option<Value>,
    /// The description of a result that is too large to be part of the state.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer: Option<LargeResult>,
    /// The goal, unless it is long.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goal: Option<Value>,
    /// The client, which has started it: `<robot>/<program>`.
    #[serde(default)]
    pub by: String,
    /// The program that carries it out; empty if it has no name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub program: String,
    /// When it was started, in milliseconds since 1970 by the robot's clock.
    #[serde(default)]
    pub began_ms: u64,
    /// When it ended.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended_ms: Option<u64>,
    /// How long ago it came to the robot's router, if that has told. It does not depend on the robot's clock, and is not part of the bytes.
    #[serde(skip)]
    pub age: Duration,
}

/// A goal of some robot.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownGoal {
    /// The robot that carries it out.
    pub robot: Name,
    /// The action.
    pub action: String,
    /// The id.
    pub id: String,
    /// The state. A goal whose program has ended is lost.
    pub state: GoalState,
}

/// The newest news of a goal that runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Feedback {
    /// The value; null if there is none.
    #[serde(default = "null", skip_serializing_if = "Value::is_null")]
    pub value: Value,
    /// How much is done, from 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<f64>,
}

impl Phase {
    /// All phases.
    pub const ALL: [Self; 9] = [
        Self::Waiting,
        Self::Running,
        Self::Cancelling,
        Self::Done,
        Self::Refused,
        Self::Failed,
        Self::Cancelled,
        Self::Preempted,
        Self::Lost,
    ];

    /// Returns whether the goal has ended.
    pub fn is_end(self) -> bool {
        !matches!(self, Self::Waiting | Self::Running | Self::Cancelling)
    }

    /// Returns the name, in lower case.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Running => "running",
            Self::Cancelling => "cancelling",
            Self::Done => "done",
            Self::Refused => "refused",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
            Self::Preempted => "preempted",
            Self::Lost => "lost",
        }
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl GoalState {
    /// Creates the state of a goal of which nothing else is known.
    pub fn new(phase: Phase) -> Self {
        Self {
            phase,
            reason: String::new(),
            result: None,
            transfer: None,
            goal: None,
            by: String::new(),
            program: String::new(),
            began_ms: 0,
            ended_ms: None,
            age: Duration::ZERO,
        }
    }

    /// Returns the state as bytes. A long goal is left out.
    pub fn write(&self) -> Payload {
        let is_long = |goal: &Value| cbor(goal).bytes.len() > MAX_GOAL;
        if !self.goal.as_ref().is_some_and(is_long) {
            return cbor(self);
        }
        cbor(&Self {
            goal: None,
            ..self.clone()
        })
    }

    /// Reads a state, whose texts are cleaned, because nothing is known about the one who has sent it.
    ///
    /// # Errors
    /// Returns the reason.
    pub fn read(payload: &Payload) -> Result<Self, String> {
        if payload.bytes.len() > MAX_BYTES {
            return Err(format!("{} bytes are too many", payload.bytes.len()));
        }
        let state: Self = payload.value().map_err(|error| error.to_string())?;
        let name = |text: &str| short(text).chars().take(MAX_NAME).collect();
        Ok(Self {
            reason: short(&state.reason),
            by: name(&state.by),
            program: name(&state.program),
            ..state
        })
    }

    /// Returns the result as a payload, unless it is large.
    pub fn result(&self) -> Option<Payload> {
        self.result.as_ref().map(to_payload)
    }
}

impl KnownGoal {
    /// Returns the goal that a retained message is about. `None` if it is about something else, the goal is forgotten, or the message is one
    /// of a recording.
    pub fn of(message: &Message) -> Option<Self> {
        let (action, id) = of_topic(message.topic.as_str())?;
        let mut state = GoalState::read(&message.payload).ok()?;
        let retained = message.retained.unwrap_or_default();
        if retained.is_forgotten || message.replayed {
            return None;
        }
        state.age = retained.age;
        if retained.has_ended && !state.phase.is_end() {
            state.phase = Phase::Lost;
            PROGRAM_ENDED.clone_into(&mut state.reason);
        }
        Some(Self {
            robot: message.sender.clone(),
            action: action.to_owned(),
            id: id.to_owned(),
            state,
        })
    }
}

impl Feedback {
    /// Creates feedback. A progress that is not a number is left out, and one beyond 0 or 1 becomes that.
    pub fn new(value: Value, progress: Option<f64>) -> Self {
        let progress = progress.filter(|progress| !progress.is_nan());
        Self {
            value,
            progress: progress.map(|progress| progress.clamp(0.0, 1.0)),
        }
    }

    /// Returns the feedback as bytes.
    pub fn write(&self) -> Payload {
        cbor(self)
    }

    /// Reads feedback.
    ///
    /// # Errors
    /// Returns the reason.
    pub fn read(payload: &Payload) -> Result<Self, String> {
        if payload.bytes.len() > MAX_BYTES {
            return Err(format!("{} bytes are too many", payload.bytes.len()));
        }
        let read: Self = payload.value().map_err(|error| error.to_string())?;
        Ok(Self::new(read.value, read.progress))
    }
}
