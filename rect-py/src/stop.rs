//! Exposes the stop of a fleet.
use std::sync::{Arc, Mutex, Weak};

use pyo3::{prelude::*, pybacked::PyBackedBytes, types::PyTuple};
use rect_core::{
    catalogue::Instance,
    stop::{self, Confirmation},
};

use crate::{
    codec::{parts, payload, Parts},
    deadman::{kind_and_robot, DeadmanSwitch, Shared},
    driver::lock,
    key_space::name,
};

/// The stop of a fleet, as this program knows it.
#[pyclass(frozen, module = "rect._rect")]
pub struct FleetStop(Mutex<State>);

struct State {
    known: stop::FleetStop,
    /// The dead man's switches that end with a stop.
    switches: Vec<Weak<Shared>>,
}

/// The program that has pressed stop, the reason, the time in milliseconds since 1970, and all of it in words.
type StopParts = (String, String, u64, String);

#[pymethods]
impl FleetStop {
    /// Creates the knowledge of the run `instance` of a program, which knows of no stop.
    #[new]
    #[pyo3(signature = (robot, program, instance))]
    fn new(robot: &str, program: Option<&str>, instance: u32) -> PyResult<Self> {
        let (robot, program) = (name(robot)?, program.map(name).transpose()?);
        let known = stop::FleetStop::new(robot, program.as_ref(), Instance(instance));
        let switches = Vec::new();
        Ok(Self(Mutex::new(State { known, switches })))
    }

    /// Reports stops and releases to a dead man's switch, beginning with those that are known.
    fn add(&self, switch: &DeadmanSwitch) {
        let mut state = lock(&self.0);
        state.switches.retain(|one| one.strong_count() > 0);
        state.switches.push(Arc::downgrade(switch.shared()));
        switch.shared().on_stop(state.known.reason());
    }

    /// Handles what a robot knows. Returns whether the message is to be published, and what is wrong with that of the robot.
    fn on_message(
        &self,
        sender: &str,
        bytes: PyBackedBytes,
        encoding: &str,
        has_ended: bool,
    ) -> PyResult<(bool, Option<String>)> {
        let (sender, payload) = (name(sender)?, payload(bytes, encoding));
        let mut state = lock(&self.0);
        Ok(match state.known.on_message(&sender, &payload, has_ended) {
            Ok(is_new) => {
                state.report();
                (is_new, None)
            }
            Err(problem) => (false, Some(problem)),
        })
    }

    /// Handles an event of the robot: the fields of an `Event`. Returns whether a confirmation may have changed.
    fn on_event(&self, event: &Bound<'_, PyTuple>) -> PyResult<bool> {
        let (kind, robot) = kind_and_robot(event)?;
        let Some(robot) = robot else {
            return Ok(false);
        };
        let mut state = lock(&self.0);
        match kind.as_str() {
            "peer_down" => state.known.on_gone(&robot),
            "peer_up" => state.known.on_returned(&robot),
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// Stops the fleet. Then publish the message.
    fn press(&self, reason: &str, now_ms: u64) {
        let mut state = lock(&self.0);
        state.known.press(reason, now_ms);
        state.report();
    }

    /// Releases all stops. Then publish the message. Returns whether there was one.
    fn release(&self) -> bool {
        let mut state = lock(&self.0);
        let was_stopped = state.known.release();
        state.report();
        was_stopped
    }

    /// Returns the message with what this program knows, which is retained.
    fn message<'py>(&self, py: Python<'py>) -> Parts<'py> {
        let message = lock(&self.0).known.message();
        parts(py, &message)
    }

    /// Whether the fleet is stopped.
    #[getter]
    fn is_stopped(&self) -> bool {
        lock(&self.0).known.is_stopped()
    }

    /// The stops that are not released, the latest first.
    #[getter]
    fn pressed(&self) -> Vec<StopParts> {
        let pressed = lock(&self.0).known.pressed().into_iter();
        pressed
            .map(|stop| {
                let in_words = stop.in_words();
                (stop.by, stop.reason, stop.at_ms, in_words)
            })
            .collect()
    }

    /// Returns whether a robot has confirmed. Raises `InvalidNameError`.
    fn confirmation(&self, robot: &str) -> PyResult<Option<&'static str>> {
        let confirmation = lock(&self.0).known.confirmation(&name(robot)?);
        Ok(confirmation.map(|confirmation| match confirmation {
            Confirmation::Confirmed => "confirmed",
            Confirmation::Waiting => "waiting",
            Confirmation::Ended => "ended",
        }))
    }
}

impl State {
    /// Reports to the dead man's switches, in the order of the changes.
    fn report(&self) {
        let reason = self.known.reason();
        for switch in self.switches.iter().filter_map(Weak::upgrade) {
            switch.on_stop(reason.clone());
        }
    }
}
