//! Exposes retained messages: those that a program publishes and receives, and the state of a program without a router.
use std::{
    sync::{Arc, Mutex},
    time::SystemTime,
};

use pyo3::{
    prelude::*,
    pybacked::PyBackedBytes,
    types::{PyBytes, PyString},
    IntoPyObjectExt,
};
use rect_core::{
    clock::unix::ms_since_1970,
    message::{
        attachment::Sent,
        retained::{value::Value, Arrival},
    },
    name::topic::Topic,
    state::{
        keeper::{Item, StateKeeper},
        latest::Latest,
        page::{self, Order},
        program,
        retain::{Outcome, Retain, NO_KEEPER},
    },
};

use crate::{
    callback::OnMessage,
    clock::Clock,
    codec::{parts, payload, Parts},
    driver::{lock, seconds, Driver, ToPython},
    key_space::{name, topic, KeySpace},
    message::{Inbound, MessageMetadata},
    urgency,
};

/// The retained messages of a program.
#[pyclass(frozen, module = "rect._rect")]
pub struct ProgramState {
    core: Arc<Mutex<program::ProgramState>>,
    clock: Clock,
    /// The callbacks of the subscriptions, which also take messages from the router.
    receivers: Mutex<Vec<(u64, Arc<Py<OnMessage>>)>>,
}

/// Something from the router, for the subscriptions.
#[pyclass(frozen, module = "rect._rect")]
pub struct StateArrival(Arrival);

/// The last value of a topic.
#[pyclass(frozen, module = "rect._rect")]
pub struct RetainedValue(Value);

/// A value for the router.
#[pyclass(frozen, module = "rect._rect")]
pub struct StateOrder {
    topic: Topic,
    order: Order,
}

/// The answer of the router that it keeps a value.
#[pyclass(frozen, module = "rect._rect")]
pub struct KeptValue(page::Kept);

#[pymethods]
impl KeptValue {
    /// A problem that the program should know.
    #[getter]
    fn warning(&self) -> Option<&str> {
        self.0.warning.as_deref()
    }
}

#[pymethods]
impl ProgramState {
    /// Creates the state of the run `instance` of a program.
    #[new]
    fn new(key_space: &KeySpace, instance: u32) -> Self {
        let clock = Clock::new();
        let core = program::ProgramState::new(key_space.0.clone(), instance, clock.created_at());
        Self {
            core: Arc::new(Mutex::new(core)),
            clock,
            receivers: Mutex::default(),
        }
    }

    /// Returns the driver to execute, whose items are for `deliver`.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Adds the subscription of a callback, and returns its number. Then poll the driver.
    fn subscribe(&self, on_message: Py<OnMessage>) -> u64 {
        let keys = on_message.get().inbound().keys_of_all();
        // Values that arrive meanwhile wait for the receiver.
        let mut receivers = lock(&self.receivers);
        let number = lock(&self.core).subscribe(&keys, self.clock.now());
        receivers.push((number, Arc::new(on_message)));
        number
    }

    /// Lets a subscription get retained messages through the router alone, if it can.
    fn follow(&self, inbound: &Inbound) {
        inbound.follow(lock(&self.core).following());
    }

    /// Removes a subscription.
    fn unsubscribe(&self, number: u64) {
        lock(&self.receivers).retain(|(known, _)| *known != number);
        lock(&self.core).unsubscribe(number, self.clock.now());
    }

    /// Delivers something from the router to all subscriptions that select it.
    fn deliver(&self, py: Python<'_>, arrival: &StateArrival) -> PyResult<()> {
        // A queue without room blocks, and the program may end a subscription meanwhile.
        let receivers = lock(&self.receivers).clone();
        for (_, receiver) in receivers {
            let receiver = receiver.get();
            for message in receiver.inbound().on_retained(&arrival.0) {
                let bytes = PyBytes::new(py, &message.payload.bytes);
                let encoding = PyString::new(py, message.payload.encoding.as_str());
                let metadata = MessageMetadata::of(message);
                receiver.push(py, metadata, &bytes, &encoding)?;
            }
        }
        Ok(())
    }

    /// Returns the order to publish and keep a value. `unix_ms` is the time in milliseconds since 1970; default: the time of the clock.
    /// Raises `InvalidTopicError` and `OptionError`.
    #[pyo3(signature = (topic, bytes, encoding, urgency, disk, unix_ms=None))]
    #[allow(clippy::too_many_arguments)] // The fields of a value.
    fn set(
        &self,
        py: Python<'_>,
        topic: &str,
        bytes: PyBackedBytes,
        encoding: &str,
        urgency: &str,
        disk: bool,
        unix_ms: Option<u64>,
    ) -> PyResult<StateOrder> {
        let (topic, urgency) = (self::topic(topic)?, urgency::parse(py, urgency)?);
        let (payload, sent) = (payload(bytes, encoding), unix_ms.map_or_else(now, Sent::At));
        let order = lock(&self.core).set(&topic, payload, urgency, disk, sent);
        Ok(StateOrder { topic, order })
    }

    /// Returns the order to forget a topic. Raises `InvalidTopicError`.
    fn forget(&self, topic: &str) -> PyResult<StateOrder> {
        let topic = self::topic(topic)?;
        let order = lock(&self.core).forget(&topic, now());
        Ok(StateOrder { topic, order })
    }

    /// Handles that the router has carried out an order.
    fn on_kept(&self, order: &StateOrder, kept: &KeptValue) {
        let StateOrder { topic, order } = order;
        lock(&self.core).on_kept(topic.clone(), order, kept.0.clone(), self.clock.now());
    }
}

#[pymethods]
impl StateOrder {
    /// Creates the driver that gives the order to the router.
    fn driver(&self, key_space: &KeySpace) -> Driver {
        let clock = Clock::new();
        let retain = Retain::new(&key_space.0, &self.order, clock.created_at());
        Driver::new(retain, &clock)
    }
}

#[pymethods]
impl RetainedValue {
    /// Returns the message of the value: its metadata, its bytes and their encoding. `None` if it has no robot.
    fn message<'py>(&self, py: Python<'py>) -> Option<(MessageMetadata, Parts<'py>)> {
        let robot = self.0.robot.clone()?;
        let metadata = MessageMetadata::of(self.0.message(robot));
        Some((metadata, parts(py, &self.0.payload)))
    }
}

/// Creates the question for the last value of a topic. Raises `InvalidNameError` and `InvalidTopicError`.
#[pyfunction]
pub fn latest(key_space: &KeySpace, robot: &str, topic: &str, timeout_s: f64) -> PyResult<Driver> {
    let (robot, topic) = (name(robot)?, self::topic(topic)?);
    let latest = Latest::new(key_space.0.clone(), robot, topic, seconds(timeout_s));
    Ok(Driver::new(latest, &Clock::new()))
}

/// Creates the state of a program without a router. Its items are warnings.
#[pyfunction]
pub fn state_keeper(key_space: &KeySpace, run: u32) -> Driver {
    let clock = Clock::new();
    let keeper = StateKeeper::of_program(key_space.0.clone(), run, clock.created_at());
    Driver::new(keeper, &clock)
}

fn now() -> Sent {
    Sent::At(ms_since_1970(SystemTime::now()))
}

impl ToPython for Arrival {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        StateArrival(self).into_py_any(py)
    }
}

impl ToPython for Option<Value> {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        self.map(RetainedValue).into_py_any(py)
    }
}

impl ToPython for Item {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        match self {
            Self::Warning(text) => text.into_py_any(py),
            // There is no disk.
            Self::Save(_) => Ok(py.None()),
        }
    }
}

impl ToPython for Outcome {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        match self {
            Self::Kept(kept) => ("kept", KeptValue(kept)).into_py_any(py),
            Self::Refused(reason) => ("refused", reason).into_py_any(py),
            Self::NoKeeper => ("no_keeper", NO_KEEPER).into_py_any(py),
            Self::Closed => ("closed", py.None()).into_py_any(py),
        }
    }
}
