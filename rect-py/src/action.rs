//! Exposes actions: the goals that this program carries out, and those that it follows.
use std::{
    sync::{Arc, Mutex},
    time::{Instant, SystemTime},
};

use bytes::Bytes;
use pyo3::{prelude::*, pybacked::PyBackedBytes, types::PyTuple, IntoPyObjectExt};
use rect_core::{
    action::{
        self,
        order::{Cancel, Order, Start},
        pull::{self, PullError},
        query::{Answers, GoalsQuery},
        result::GoalResult,
        run, server,
        server::{Outcome, Publication, Rules, Work},
        state::{Feedback, KnownGoal, Phase},
    },
    clock::unix::ms_since_1970,
    message::{encoding::Encoding, payload::Payload, Message},
    name::Name,
    registry::connection::Event,
    session::names,
    text::humanize,
};

use crate::{
    action_result::{ResultPull, ResultToKeep},
    clock::Clock,
    codec::{parts, payload, Parts},
    deadman::kind_and_robot,
    detached::detached,
    driver::{lock, seconds, Driver, ToPython},
    errors::{raised, OrRaise},
    key_space::{name, KeySpace},
    message::MessageMetadata,
};

/// The goals of one action of this program.
#[pyclass(frozen, module = "rect._rect")]
pub struct ActionServer(Mutex<server::ActionServer>);

/// A goal that this program follows.
#[pyclass(frozen, module = "rect._rect")]
pub struct ActionRun {
    robot: Name,
    action: String,
    id: String,
    core: Mutex<run::ActionRun>,
}

/// A request to an action.
#[pyclass(frozen, module = "rect._rect")]
pub struct ActionOrder(Order);

/// The retained message with the state of a goal.
#[pyclass(frozen, module = "rect._rect")]
pub struct GoalMessage(Message);

/// The value and the progress of feedback.
type FeedbackParts<'py> = (Parts<'py>, Option<f64>);
/// A goal: its robot, action, id, phase and reason, its result and its value, who has started it, the program that carries it out, and when
/// it began and ended, in milliseconds since 1970, and for how long the robot's router has known the state, in seconds.
type GoalParts<'py> = (
    (String, String, String),
    (&'static str, String),
    (Option<Parts<'py>>, Option<Parts<'py>>),
    (String, String),
    (u64, Option<u64>, f64),
);

#[pymethods]
impl ActionServer {
    /// Creates an action of a program. `lost_after_s`: `None` if its goals are carried out without their clients, too.
    #[new]
    #[pyo3(signature = (program, refuses, lost_after_s))]
    fn new(program: Option<&str>, refuses: bool, lost_after_s: Option<f64>) -> PyResult<Self> {
        let program = program.map(name).transpose()?;
        let lost_after = lost_after_s.map(seconds);
        let rules = Rules {
            refuses,
            lost_after,
        };
        let server = server::ActionServer::new(program.as_ref(), rules);
        Ok(Self(Mutex::new(server)))
    }

    /// Handles a goal of an earlier run of the program.
    fn on_earlier(&self, goal: &GoalMessage) {
        if let Some((_, id)) = action::of_topic(goal.0.topic.as_str()) {
            lock(&self.0).on_earlier(id, &goal.0.payload, Instant::now(), now_ms());
        }
    }

    /// Handles an order. `number` is chosen by the caller.
    #[pyo3(signature = (number, sender, bytes, encoding))]
    fn on_order(
        &self,
        number: u64,
        sender: Option<&str>,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> PyResult<()> {
        let sender = sender.map(name).transpose()?;
        let payload = payload(bytes, encoding);
        lock(&self.0).on_order(number, sender.as_ref(), &payload, now_ms());
        Ok(())
    }

    /// Handles whether the router keeps the state that was published: `None`, or else the reason why it does not.
    #[pyo3(signature = (id, reason))]
    fn on_published(&self, id: &str, reason: Option<String>) {
        let result = reason.map_or(Ok(()), Err);
        lock(&self.0).on_published(id, result, Instant::now(), now_ms());
    }

    /// Handles feedback of a handler. Raises `PayloadError` if its value is too large.
    #[pyo3(signature = (id, bytes, encoding, progress))]
    fn on_feedback(
        &self,
        id: &str,
        bytes: PyBackedBytes,
        encoding: &str,
        progress: Option<f64>,
    ) -> PyResult<()> {
        let value = action::to_value(&payload(bytes, encoding)).map_err(wrong_value)?;
        lock(&self.0).on_feedback(id, Feedback::new(value, progress));
        Ok(())
    }

    /// Handles that a handler has returned a result. Raises `PayloadError` if it is too large.
    fn on_done(
        &self,
        py: Python<'_>,
        id: &str,
        bytes: PyBackedBytes,
        encoding: &str,
        noticed: bool,
    ) -> PyResult<()> {
        // A large result is kept after this call, and without Python.
        let bytes = Bytes::copy_from_slice(&bytes);
        let payload = Payload::new(bytes, Encoding::new(encoding.to_owned()));
        let result = detached(py, || GoalResult::new(id, payload)).map_err(wrong_value)?;
        lock(&self.0).on_end(id, Outcome::Done { result, noticed }, now_ms());
        Ok(())
    }

    /// Handles that a handler has failed.
    fn on_failed(&self, id: &str, reason: String) {
        lock(&self.0).on_end(id, Outcome::Failed(reason), now_ms());
    }

    /// Handles that a handler has ended because it was asked to.
    fn on_cancelled(&self, id: &str) {
        lock(&self.0).on_end(id, Outcome::Cancelled, now_ms());
    }

    /// Handles an event of the robot: the fields of an `Event`.
    fn on_event(&self, event: &Bound<'_, PyTuple>) -> PyResult<()> {
        if let Some(event) = of_fields(event)? {
            lock(&self.0).on_event(&event, Instant::now());
        }
        Ok(())
    }

    /// Handles that the fleet was stopped, for this reason, or released (`None`).
    #[pyo3(signature = (reason))]
    fn on_stop(&self, reason: Option<String>) {
        lock(&self.0).on_stop(reason, now_ms());
    }

    /// Cancels all goals, because the action ends.
    fn close(&self) {
        lock(&self.0).close(now_ms());
    }

    /// Returns what to do now: `reply` with the number of an order and the reason if it is refused, `run` with a goal, its value and who has
    /// started it, `cancel` with a goal and the reason, or `wait` with the seconds (`None`: until something happens).
    fn work<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let now = Instant::now();
        let work = lock(&self.0).work(now, now_ms());
        match work {
            Work::Reply { order, refused } => ("reply", order, refused).into_pyobject(py),
            Work::Run { id, goal, by } => {
                ("run", id, parts(py, &action::to_payload(&goal)), by).into_pyobject(py)
            }
            Work::Cancel { id, reason } => ("cancel", id, reason).into_pyobject(py),
            Work::Wait(until) => ("wait", remaining(until, now)).into_pyobject(py),
        }
    }

    /// Returns what to publish now: `keep` with a large result, `state` with a goal, the payload and its urgency, `feedback` with a goal and
    /// the payload, `forget` with a goal, or `wait` as `work` does.
    fn publication<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let now = Instant::now();
        let publication = lock(&self.0).publication(now);
        match publication {
            Publication::State {
                id,
                payload,
                is_urgent,
            } => {
                let urgency = if is_urgent { "urgent" } else { "normal" };
                ("state", id, parts(py, &payload), urgency).into_pyobject(py)
            }
            Publication::Serve { result, bytes } => {
                ("keep", ResultToKeep(result, bytes)).into_pyobject(py)
            }
            Publication::Feedback { id, payload } => {
                ("feedback", id, parts(py, &payload)).into_pyobject(py)
            }
            Publication::Forget { id } => ("forget", id).into_pyobject(py),
            Publication::Wait(until) => ("wait", remaining(until, now)).into_pyobject(py),
        }
    }

    /// Whether all goals have ended, and the router knows that.
    #[getter]
    fn is_finished(&self) -> bool {
        lock(&self.0).is_finished()
    }
}

#[pymethods]
impl ActionRun {
    /// Creates a goal of a robot, which has accepted it, or has refused it for a reason.
    #[new]
    #[pyo3(signature = (robot, action, id, refused=None))]
    fn new(robot: &str, action: &str, id: &str, refused: Option<&str>) -> PyResult<Self> {
        let (robot, now) = (name(robot)?, Instant::now());
        let core = match refused {
            Some(reason) => run::ActionRun::refused(robot.clone(), reason, now),
            None => run::ActionRun::new(robot.clone(), now),
        };
        Ok(Self {
            robot,
            action: action.to_owned(),
            id: id.to_owned(),
            core: Mutex::new(core),
        })
    }

    /// Handles a message of the goal. Returns the feedback that it contains, if any.
    fn on_message<'py>(
        &self,
        py: Python<'py>,
        metadata: &MessageMetadata,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> Option<FeedbackParts<'py>> {
        let message = Message {
            payload: payload(bytes, encoding),
            ..metadata.message()
        };
        let now = Instant::now();
        if action::of_topic(message.topic.as_str()).is_some() {
            lock(&self.core).on_message(&message, now);
            return None;
        }
        let feedback = Feedback::read(&message.payload).ok()?;
        lock(&self.core).on_feedback(feedback.clone(), now);
        Some(feedback_parts(py, &feedback))
    }

    /// Handles the answer to the question that `asks` asks: the state, or `None` if the robot does not know the goal.
    #[pyo3(signature = (goal))]
    fn on_answer(&self, goal: Option<&GoalMessage>) {
        let message = goal.map(|goal| &goal.0);
        lock(&self.core).on_answer(message, Instant::now());
    }

    /// Handles that the robot did not answer.
    fn on_no_answer(&self) {
        lock(&self.core).on_no_answer(Instant::now());
    }

    /// Handles an event of the robot: the fields of an `Event`.
    fn on_event(&self, event: &Bound<'_, PyTuple>) -> PyResult<()> {
        if let Some(event) = of_fields(event)? {
            lock(&self.core).on_event(&event, Instant::now());
        }
        Ok(())
    }

    /// Returns whether the robot is to be asked for the state now.
    fn asks(&self) -> bool {
        lock(&self.core).asks(Instant::now())
    }

    /// Returns the seconds until `asks` is to be called; `None`: not until something happens.
    fn wait(&self) -> Option<f64> {
        let deadline = lock(&self.core).deadline();
        remaining(deadline, Instant::now())
    }

    #[getter]
    fn robot(&self) -> &str {
        self.robot.as_str()
    }

    #[getter]
    fn action(&self) -> &str {
        &self.action
    }

    #[getter]
    fn id(&self) -> &str {
        &self.id
    }

    #[getter]
    fn phase(&self) -> &'static str {
        lock(&self.core).state().phase.as_str()
    }

    /// For how long it has been in this phase, in seconds.
    #[getter]
    fn phase_for(&self) -> f64 {
        lock(&self.core).since().elapsed().as_secs_f64()
    }

    #[getter]
    fn reason(&self) -> String {
        lock(&self.core).state().reason.clone()
    }

    #[getter]
    fn has_ended(&self) -> bool {
        lock(&self.core).has_ended()
    }

    /// The result; `None` if there is none, or it is large.
    #[getter]
    fn result<'py>(&self, py: Python<'py>) -> Option<Parts<'py>> {
        let result = lock(&self.core).state().result();
        result.map(|result| parts(py, &result))
    }

    /// Begins to receive a large result; `None` if the goal has none. Raises `ActionError` if it cannot be received.
    fn pull(&self, py: Python<'_>, key_space: &KeySpace) -> PyResult<Option<ResultPull>> {
        let state = lock(&self.core).state().clone();
        let (Phase::Done, Some(large)) = (state.phase, state.transfer) else {
            return Ok(None);
        };
        let (place, clock) = (&key_space.0, Clock::new());
        let now = clock.created_at();
        let pull = pull::ResultPull::new(place, &self.robot, &self.action, &self.id, &large, now);
        match pull {
            Ok(pull) => Ok(Some(ResultPull {
                core: Arc::new(Mutex::new(pull)),
                clock,
            })),
            Err(PullError::Closed) => Ok(None),
            Err(PullError::Unavailable(reason)) => Err(raised(py, "ActionError", ("done", reason))),
        }
    }

    /// The newest feedback.
    #[getter]
    fn feedback<'py>(&self, py: Python<'py>) -> Option<FeedbackParts<'py>> {
        let feedback = lock(&self.core).feedback().cloned();
        feedback.map(|feedback| feedback_parts(py, &feedback))
    }

    /// For how long the robot cannot be reached, in seconds; `None` if it can be.
    #[getter]
    fn unreachable_for(&self) -> Option<f64> {
        let since = lock(&self.core).unreachable_since();
        since.map(|since| since.elapsed().as_secs_f64())
    }

    /// The description of the end that is waited for, for the text of a timeout.
    #[getter]
    fn expected(&self) -> String {
        let core = lock(&self.core);
        let (phase, time) = (core.state().phase, core.since().elapsed());
        let unreachable = core.unreachable_since().map(|since| {
            let time = humanize::duration(since.elapsed());
            format!("; {} cannot be reached for {time}", self.robot)
        });
        format!(
            "end of {} of {} ({phase} for {}{})",
            self.action,
            self.robot,
            humanize::duration(time),
            unreachable.unwrap_or_default()
        )
    }
}

#[pymethods]
impl ActionOrder {
    /// Creates the order to start a goal. Raises `PayloadError` if its value is too large, and `OptionError` if its id is invalid.
    #[staticmethod]
    #[pyo3(signature = (id, bytes, encoding, program, feedback_per_s))]
    fn start(
        py: Python<'_>,
        id: String,
        bytes: PyBackedBytes,
        encoding: &str,
        program: Option<String>,
        feedback_per_s: Option<f64>,
    ) -> PyResult<Self> {
        let order = Order::Start(Start {
            id: id.clone(),
            goal: action::to_value(&payload(bytes, encoding)).map_err(wrong_value)?,
            by: program.unwrap_or_default(),
            feedback_per_s,
        });
        match Order::read(&order.write()) {
            Ok(_) => Ok(Self(order)),
            Err(reason) => Err(raised(py, "OptionError", ("id", id, reason))),
        }
    }

    /// Creates the order to cancel a goal.
    #[staticmethod]
    #[pyo3(signature = (id, program))]
    fn cancel(id: String, program: Option<String>) -> Self {
        let by = program.unwrap_or_default();
        Self(Order::Cancel(Cancel { id, by }))
    }

    /// Returns the request with the order.
    fn payload<'py>(&self, py: Python<'py>) -> Parts<'py> {
        parts(py, &self.0.write())
    }
}

#[pymethods]
impl GoalMessage {
    /// Returns what is known about the goal; `None` if it is forgotten, or the message is about something else.
    fn goal<'py>(&self, py: Python<'py>) -> Option<GoalParts<'py>> {
        let KnownGoal {
            robot,
            action,
            id,
            state,
        } = KnownGoal::of(&self.0)?;
        let result = state.result().map(|result| parts(py, &result));
        let goal = state.goal.as_ref().map(action::to_payload);
        Some((
            (robot.to_string(), action, id),
            (state.phase.as_str(), state.reason),
            (result, goal.map(|goal| parts(py, &goal))),
            (state.by, state.program),
            (state.began_ms, state.ended_ms, state.age.as_secs_f64()),
        ))
    }
}

/// Returns the value of the goal that an order starts; `None` if it is another one.
#[pyfunction]
pub fn goal_to_start<'py>(
    py: Python<'py>,
    bytes: PyBackedBytes,
    encoding: &str,
) -> Option<Parts<'py>> {
    match Order::read(&payload(bytes, encoding)) {
        Ok(Order::Start(start)) => Some(parts(py, &action::to_payload(&start.goal))),
        _ => None,
    }
}

/// Returns the id of a goal that is made of a random number.
#[pyfunction]
pub fn goal_id(random: u64) -> String {
    action::goal_id(random)
}

/// Returns the topic of the state of a goal.
#[pyfunction]
pub fn goal_topic(action: &str, goal: &str) -> String {
    action::topic(action, goal)
}

/// Returns the topic of the feedback of a goal.
#[pyfunction]
pub fn goal_feedback_topic(action: &str, goal: &str) -> String {
    action::feedback_topic(action, goal)
}

/// Returns the error that a goal has ended without being done.
#[pyfunction]
pub fn goal_ended(phase: &str, reason: &str) -> String {
    let phase = Phase::ALL.into_iter().find(|one| one.as_str() == phase);
    action::goal_ended(phase.unwrap_or(Phase::Lost), reason)
}

/// Returns the error that a robot has no such action.
#[pyfunction]
pub fn no_action(robot: &str, action: &str, available: Vec<String>) -> PyResult<String> {
    Ok(names::no_action(&name(robot)?, action, &available))
}

/// Creates the question for the goals of a robot, or of all robots (`*`). `*` stands for all actions and goals, too. Finishes with the robots
/// that have answered, and with messages. Raises `InvalidTopicError`.
#[pyfunction]
pub fn goals_query(
    key_space: &KeySpace,
    robot: &str,
    action: &str,
    goal: &str,
    timeout_s: f64,
) -> PyResult<Driver> {
    let (place, timeout) = (key_space.0.clone(), seconds(timeout_s));
    let query = GoalsQuery::new(place, robot, action, goal, timeout).or_raise()?;
    Ok(Driver::new(query, &Clock::new()))
}

impl ToPython for Answers {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let robots: Vec<_> = self.robots.iter().map(ToString::to_string).collect();
        let goals: Vec<_> = self.goals.into_iter().map(GoalMessage).collect();
        (robots, goals).into_py_any(py)
    }
}

/// Raises `PayloadError` for a value that cannot be part of a message.
fn wrong_value(reason: String) -> PyErr {
    Python::attach(|py| raised(py, "PayloadError", (reason, "write")))
}

fn feedback_parts<'py>(py: Python<'py>, feedback: &Feedback) -> FeedbackParts<'py> {
    let value = action::to_payload(&feedback.value);
    (parts(py, &value), feedback.progress)
}

/// Reads the fields of an `Event`; `None` if it is not about a robot or program that comes or goes.
fn of_fields(fields: &Bound<'_, PyTuple>) -> PyResult<Option<Event>> {
    let (kind, Some(robot)) = kind_and_robot(fields)? else {
        return Ok(None);
    };
    // Fields at the end that are not known are missing.
    let program = fields.get_item(6).and_then(|program| program.extract());
    let program: Option<String> = program.unwrap_or_default();
    let program = program.and_then(|program| Name::new(&program).ok());
    Ok(match (kind.as_str(), program) {
        ("peer_up", _) => Some(Event::PeerUp { robot }),
        ("peer_down", _) => Some(Event::PeerDown { robot }),
        ("program_up", Some(program)) => Some(Event::ProgramUp { robot, program }),
        ("program_down", Some(program)) => Some(Event::ProgramDown { robot, program }),
        _ => None,
    })
}

fn remaining(until: Option<Instant>, now: Instant) -> Option<f64> {
    until.map(|at| at.saturating_duration_since(now).as_secs_f64())
}

fn now_ms() -> u64 {
    ms_since_1970(SystemTime::now())
}
