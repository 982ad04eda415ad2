//! Exposes the log: the lines that a program gives to its router, the reading of logs, the log of a program without a router, and alerts.
use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::Duration,
};

use pyo3::{
    exceptions::PyException,
    prelude::*,
    types::{PyDict, PyString},
    IntoPyObjectExt,
};
use rect_core::{
    alert::{
        self,
        query::{AlertsQuery, RobotAlert},
    },
    log::{
        keeper::LogKeeper,
        level::Level,
        line::Line,
        outbox::Outbox,
        page::Kept,
        reader::{Item, LogReader, Reading},
    },
    name::Name,
};
use serde_json::Value;

use crate::{
    clock::Clock,
    codec::{parts, Parts},
    driver::{lock, seconds, Driver, ToPython},
    errors::{raised, OrRaise},
    key_space::{name, KeySpace},
    value::write_value,
};

/// The lines of a program that its router does not have yet.
#[pyclass(frozen, module = "rect._rect")]
pub struct LogOutbox {
    core: Arc<Mutex<Outbox>>,
    clock: Clock,
}

#[pymethods]
impl LogOutbox {
    /// Creates the lines of the run `run` of a program.
    #[new]
    #[pyo3(signature = (key_space, program, run))]
    fn new(key_space: &KeySpace, program: Option<&str>, run: u32) -> PyResult<Self> {
        let program = program.map(name).transpose()?;
        let outbox = Outbox::new(&key_space.0, program.as_ref(), run);
        Ok(Self {
            core: Arc::new(Mutex::new(outbox)),
            clock: Clock::new(),
        })
    }

    /// Returns the driver to execute.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Adds a line. Returns whether to poll the driver. Raises `OptionError` if there is no such level.
    #[allow(clippy::too_many_arguments)] // The fields of a line.
    fn log(
        &self,
        py: Python<'_>,
        at_ms: u64,
        level: &Bound<'_, PyString>,
        logger: &Bound<'_, PyString>,
        text: &Bound<'_, PyString>,
        fields: &Bound<'_, PyDict>,
        source: &Bound<'_, PyString>,
        is_private: bool,
    ) -> PyResult<bool> {
        let level = parse(py, &level.to_string_lossy())?;
        let fields: PyResult<BTreeMap<_, _>> = fields
            .iter()
            .map(|(name, value)| Ok((shown(&name)?, field(&value)?)))
            .collect();
        let line = Line {
            logger: logger.to_string_lossy().into_owned(),
            fields: fields?,
            source: source.to_string_lossy().into_owned(),
            ..Line::new(at_ms, level, text.to_string_lossy())
        };
        Ok(lock(&self.core).log(line, is_private, self.clock.now()))
    }

    /// Sends the lines that wait as soon as the router receives them, and after `within_s` in any case.
    fn flush(&self, within_s: f64) {
        let now = self.clock.now();
        lock(&self.core).flush(now, now + Duration::from_secs_f64(within_s));
    }

    /// Whether no line waits.
    #[getter]
    fn is_empty(&self) -> bool {
        lock(&self.core).is_empty()
    }
}

/// Creates a reader. `robot` and `program`: `None` for all. Its items are the kind, the robot, whether the lines are new, and the lines.
/// Raises `OptionError` and `InvalidNameError`.
#[pyfunction]
#[pyo3(signature = (key_space, robot, program, level, last, follow, timeout_s))]
#[allow(clippy::too_many_arguments)] // The selected lines.
pub fn log_reader(
    py: Python<'_>,
    key_space: &KeySpace,
    robot: Option<&str>,
    program: Option<&str>,
    level: &Bound<'_, PyString>,
    last: usize,
    follow: bool,
    timeout_s: f64,
) -> PyResult<Driver> {
    let reading = Reading {
        robot: robot.map(name).transpose()?,
        program: program.map(name).transpose()?,
        level: parse(py, &level.to_string_lossy())?,
        last,
        follow,
        timeout: seconds(timeout_s),
        ..Reading::default()
    };
    let reader = LogReader::new(key_space.0.clone(), reading);
    Ok(Driver::new(reader, &Clock::new()))
}

/// Creates the log of a program without a router.
#[pyfunction]
pub fn log_keeper(key_space: &KeySpace, run: u32) -> Driver {
    Driver::new(LogKeeper::new(key_space.0.clone(), run), &Clock::new())
}

/// Returns the level of a number of the module `logging`.
#[pyfunction]
pub fn level_of_logging(number: i64) -> &'static str {
    Level::of_python(number).as_str()
}

/// Returns the topic of an alert with a name or text. Raises `InvalidTopicError`.
#[pyfunction]
pub fn alert_topic(text: &Bound<'_, PyString>) -> PyResult<String> {
    Ok(alert::topic(&text.to_string_lossy())
        .or_raise()?
        .to_string())
}

/// Writes an alert. Raises `OptionError` if there is no such level.
#[pyfunction]
#[pyo3(signature = (text, level, at_ms, program))]
pub fn write_alert<'py>(
    py: Python<'py>,
    text: &Bound<'py, PyString>,
    level: &Bound<'py, PyString>,
    at_ms: u64,
    program: Option<&str>,
) -> PyResult<Parts<'py>> {
    let alert = alert::Alert {
        text: text.to_string_lossy().into_owned(),
        level: parse(py, &level.to_string_lossy())?,
        at: at_ms,
        program: program.unwrap_or_default().to_owned(),
    };
    Ok(parts(py, &alert.write()))
}

/// Creates the question for the alerts of a robot, or of all robots. Raises `InvalidNameError`.
#[pyfunction]
#[pyo3(signature = (key_space, robot, timeout_s))]
pub fn alerts_query(key_space: &KeySpace, robot: Option<&str>, timeout_s: f64) -> PyResult<Driver> {
    let robot = robot.map(name).transpose()?;
    let timeout: Duration = seconds(timeout_s);
    let query = AlertsQuery::new(key_space.0.clone(), robot, timeout);
    Ok(Driver::new(query, &Clock::new()))
}

/// Parses a level. Raises `OptionError`.
fn parse(py: Python<'_>, text: &str) -> PyResult<Level> {
    text.parse().map_err(|_| {
        let expected = "it must be \"debug\", \"info\", \"warn\" or \"error\"";
        raised(py, "OptionError", ("level", text, expected))
    })
}

/// Returns the value of a field: as JSON if that can represent it, or else as text.
fn field(value: &Bound<'_, PyAny>) -> PyResult<Value> {
    match write_value(value, false) {
        Ok((json, _)) => Ok(serde_json::from_slice(json.as_bytes()).unwrap_or_default()),
        Err(error) if error.is_instance_of::<PyException>(value.py()) => {
            shown(value).map(Value::from)
        }
        // Such as a KeyboardInterrupt.
        Err(error) => Err(error),
    }
}

/// Returns a value as text; an object whose `__str__` fails as the name of its class.
fn shown(value: &Bound<'_, PyAny>) -> PyResult<String> {
    let text = match value.str() {
        Err(error) if error.is_instance_of::<PyException>(value.py()) => value.get_type().name()?,
        text => text?,
    };
    Ok(text.to_string_lossy().into_owned())
}

/// The fields of a line: its number, program, time in milliseconds since 1970, level, logger, text, fields and source.
type LineParts<'py> = (
    u64,
    String,
    u64,
    &'static str,
    String,
    String,
    Bound<'py, PyDict>,
    String,
);

fn line(py: Python<'_>, kept: Kept) -> PyResult<LineParts<'_>> {
    let Kept {
        number,
        program,
        line,
    } = kept;
    let fields = PyDict::new(py);
    for (name, value) in line.fields {
        let value = match value {
            Value::Null => py.None(),
            Value::Bool(truth) => truth.into_py_any(py)?,
            Value::String(text) => text.into_py_any(py)?,
            Value::Number(number) => match number.as_i64() {
                Some(number) => number.into_py_any(py)?,
                None => number.as_f64().into_py_any(py)?,
            },
            // A line that was read has none of these.
            other => other.to_string().into_py_any(py)?,
        };
        fields.set_item(name, value)?;
    }
    let level = line.level.as_str();
    let parts = (line.logger, line.text, fields, line.source);
    let (logger, text, fields, source) = parts;
    Ok((
        number, program, line.at, level, logger, text, fields, source,
    ))
}

impl ToPython for Item {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let (kind, robot, lines, is_new) = match self {
            Self::Lines {
                robot,
                lines,
                is_new,
            } => ("lines", Some(robot), lines, is_new),
            Self::Missed(robot) => ("missed", Some(robot), Vec::new(), true),
            Self::Complete => ("complete", None, Vec::new(), false),
        };
        let lines = lines.into_iter().map(|kept| line(py, kept));
        let lines: Vec<_> = lines.collect::<PyResult<_>>()?;
        (kind, robot.as_ref().map(Name::as_str), is_new, lines).into_py_any(py)
    }
}

impl ToPython for Option<Vec<RobotAlert>> {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let all = self.map(|alerts| {
            let alerts = alerts.into_iter().map(|one| {
                let (robot, name) = (one.robot.to_string(), one.name().to_owned());
                let (alert, has_ended) = (one.alert, one.retained.has_ended);
                let (text, level) = (alert.text, alert.level.as_str());
                (robot, name, text, level, alert.at, alert.program, has_ended)
            });
            alerts.collect::<Vec<_>>()
        });
        all.into_py_any(py)
    }
}
