//! Exposes the dead man's switch. A thread of its own waits for the end of the commands, so that a Python thread that sleeps does not
//! delay it.
use std::{
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use pyo3::{prelude::*, pybacked::PyBackedBytes, types::PyTuple};
use rect_core::{
    deadman::{Deadman, ENDED},
    message::Message,
    name::Name,
};

use crate::{
    codec::payload,
    detached::{attached, detached},
    driver::{lock, seconds},
    errors::raised,
    message::MessageMetadata,
};

/// The longest wait for the end of `on_lost` when a switch is closed.
const END_TIMEOUT: Duration = Duration::from_secs(1);

/// A dead man's switch.
#[pyclass(frozen, module = "rect._rect")]
pub struct DeadmanSwitch(Arc<Shared>);

/// The part that the thread of a switch shares with the program.
pub struct Shared {
    within: Duration,
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    switch: Deadman,
    /// Whether `on_lost` is running.
    is_losing: bool,
    /// Whether the function for commands is running.
    is_driving: bool,
    /// Why the commander was lost while the function for commands was running, which may have moved something since: `on_lost` is called
    /// again when it has returned.
    repeat: Option<String>,
    phase: Phase,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Running,
    /// `on_lost` is to be called for the last time.
    Ending,
    Ended,
}

#[pymethods]
impl DeadmanSwitch {
    /// Creates a switch, which begins as lost. Raises `OptionError`.
    #[new]
    fn new(py: Python<'_>, within_s: f64) -> PyResult<Self> {
        let within = seconds(within_s);
        let switch = Deadman::new(within)
            .map_err(|reason| raised(py, "OptionError", ("within", within_s, reason)))?;
        let state = State {
            switch,
            is_losing: false,
            is_driving: false,
            repeat: None,
            phase: Phase::Running,
        };
        Ok(Self(Arc::new(Shared {
            within,
            state: Mutex::new(state),
            changed: Condvar::new(),
        })))
    }

    /// Starts the thread that calls `on_lost` with the reason of each loss. Raises `ThreadError`.
    fn start(&self, py: Python<'_>, on_lost: Py<PyAny>) -> PyResult<()> {
        let shared = self.0.clone();
        let thread = thread::Builder::new().name("rect deadman".to_owned());
        let started = thread.spawn(move || shared.run(&on_lost));
        started.map_err(|error| raised(py, "ThreadError", (error.to_string(),)))?;
        Ok(())
    }

    /// Returns whether the program may carry out a command. If so, call `finish` afterwards. Waits while `on_lost` is running, so that
    /// nothing moves after it.
    fn begin(
        &self,
        py: Python<'_>,
        metadata: &MessageMetadata,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> bool {
        let command = Message {
            payload: payload(bytes, encoding),
            ..metadata.message()
        };
        let arrived_at = metadata.arrived_at();
        detached(py, || self.0.begin(arrived_at, &command))
    }

    /// Handles that the program has carried out a command.
    fn finish(&self) {
        lock(&self.0.state).is_driving = false;
        self.0.changed.notify_all();
    }

    /// Handles an event of the robot: the fields of an `Event`.
    fn on_event(&self, event: &Bound<'_, PyTuple>) -> PyResult<()> {
        let (kind, robot) = kind_and_robot(event)?;
        let Some(robot) = robot else { return Ok(()) };
        let mut state = lock(&self.0.state);
        match kind.as_str() {
            "peer_down" => state.switch.on_gone(&robot),
            "peer_up" => state.switch.on_returned(Instant::now(), &robot),
            "program_down" => state.switch.on_program_gone(Instant::now(), &robot),
            _ => return Ok(()),
        }
        self.0.changed.notify_all();
        Ok(())
    }

    /// Whether the robot follows commands.
    #[getter]
    fn is_following(&self) -> bool {
        let state = lock(&self.0.state);
        state.phase == Phase::Running && state.switch.is_following()
    }

    /// Ends the switch, as a loss. Waits until `on_lost` has returned, for at most a second.
    fn end(&self, py: Python<'_>) {
        detached(py, || self.0.end());
    }
}

impl DeadmanSwitch {
    pub fn shared(&self) -> &Arc<Shared> {
        &self.0
    }
}

/// Returns the kind of an event, and the robot that it is about.
pub fn kind_and_robot(event: &Bound<'_, PyTuple>) -> PyResult<(String, Option<Name>)> {
    // Events of the router have no robot.
    let robot = event.get_item(1).and_then(|robot| robot.extract());
    let robot: Option<String> = robot.unwrap_or_default();
    let robot = robot.and_then(|robot| Name::new(&robot).ok());
    Ok((event.get_item(0)?.extract()?, robot))
}

impl Shared {
    /// Handles that the fleet was stopped, for this reason, or released (`None`).
    pub fn on_stop(&self, stopped: Option<String>) {
        lock(&self.state).switch.on_stop(stopped);
        self.changed.notify_all();
    }

    fn begin(&self, arrived_at: Instant, command: &Message) -> bool {
        let mut state = lock(&self.state);
        while state.is_losing || state.repeat.is_some() {
            state = self.wait(state, None);
        }
        // The program was busy for so long that the command is too old.
        let is_stale = arrived_at.elapsed() >= self.within;
        if state.phase != Phase::Running || is_stale {
            return false;
        }
        let was_following = state.switch.is_following();
        let counts = state.switch.on_command(arrived_at, command);
        state.is_driving = counts;
        if counts && !was_following {
            // Otherwise the thread waits for a deadline already, and then for the next one.
            self.changed.notify_all();
        }
        counts
    }

    fn end(&self) {
        let mut state = lock(&self.state);
        if state.phase == Phase::Running {
            state.phase = Phase::Ending;
            self.changed.notify_all();
        }
        let deadline = Instant::now() + END_TIMEOUT;
        while state.phase == Phase::Ending || state.is_losing {
            if Instant::now() >= deadline {
                return;
            }
            state = self.wait(state, Some(deadline));
        }
    }

    fn run(&self, on_lost: &Py<PyAny>) {
        let mut state = lock(&self.state);
        loop {
            if let Some(reason) = state.due(Instant::now()) {
                state.is_losing = true;
                drop(state);
                attached(|py| {
                    if let Err(error) = on_lost.call1(py, (reason,)) {
                        error.write_unraisable(py, Some(on_lost.bind(py)));
                    }
                });
                state = lock(&self.state);
                state.is_losing = false;
                self.changed.notify_all();
                continue;
            }
            if state.phase == Phase::Ended && state.repeat.is_none() {
                return;
            }
            let is_running = state.phase == Phase::Running;
            let deadline = state.switch.deadline().filter(|_| is_running);
            state = self.wait(state, deadline);
        }
    }

    fn wait<'a>(
        &self,
        state: MutexGuard<'a, State>,
        deadline: Option<Instant>,
    ) -> MutexGuard<'a, State> {
        match deadline {
            None => self
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner),
            Some(deadline) => {
                let remaining = deadline.saturating_duration_since(Instant::now());
                let waited = self.changed.wait_timeout(state, remaining);
                waited.unwrap_or_else(PoisonError::into_inner).0
            }
        }
    }
}

impl State {
    /// Returns the reason with which to call `on_lost` now.
    fn due(&mut self, now: Instant) -> Option<String> {
        let lost = match self.phase {
            Phase::Running => self.switch.poll(now),
            Phase::Ending => {
                self.phase = Phase::Ended;
                Some(ENDED.to_owned())
            }
            Phase::Ended => None,
        };
        if lost.is_none() && !self.is_driving {
            return self.repeat.take();
        }
        if lost.is_some() && self.is_driving {
            self.repeat.clone_from(&lost);
        }
        lost
    }
}
