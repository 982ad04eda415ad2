//! Exposes requests that are repeated and carried out at most once, of a requester and of a service.
use std::time::Instant;

use pyo3::{
    intern,
    prelude::*,
    pybacked::PyBackedBytes,
    types::{PyBytes, PyDict},
    IntoPyObjectExt,
};
use rect_core::{
    catalogue::Instance,
    driver::Answer,
    message::request::RequestHeader,
    retry::{
        once::{self, Admission},
        request::{Outcome, RetriedRequest},
    },
};

use crate::{
    clock::Clock,
    codec::{parts, payload},
    driver::{lock, Driver, ToPython},
    errors::raised,
    key_space::name,
    program::Catalogues,
    request::{kind_parts, Inquiry, KindParts},
    urgency,
};

/// The requests that a program carries out at most once.
#[pyclass(frozen, module = "rect._rect")]
pub struct Once(once::Once<Py<PyAny>>);

/// The permission to carry out one request, which takes its result.
#[pyclass(frozen, module = "rect._rect")]
pub struct Execution(once::Execution<Py<PyAny>>);

/// A request to carry out, with its permission if it may be carried out only once.
type Admitted = (Py<PyAny>, Option<Execution>);

#[pymethods]
impl Once {
    /// Creates the memory of the run `instance` of a program of a robot.
    #[new]
    fn new(robot: &str, instance: u32) -> PyResult<Self> {
        Ok(Self(once::Once::new(name(robot)?, Instance(instance))))
    }
}

impl Once {
    /// Handles the query of a request with that header. Returns it if the program is to carry it out; any other one has been answered or
    /// waits.
    pub fn admit(
        &self,
        py: Python<'_>,
        header: Option<&RequestHeader>,
        query: Py<PyAny>,
    ) -> PyResult<Option<Admitted>> {
        let now = Instant::now();
        let ended = match self.0.on_request(now, header, query) {
            Admission::Execute(query, execution) => {
                return Ok(Some((query, execution.map(Execution))));
            }
            Admission::Wait(replaced) => replaced,
            Admission::Answer(query, answer) => {
                send(query.bind(py), &answer)?;
                Some(query)
            }
        };
        if let Some(query) = ended {
            query.call_method0(py, intern!(py, "drop"))?;
        }
        Ok(None)
    }
}

/// Answers a query.
fn send(query: &Bound<'_, PyAny>, answer: &Answer) -> PyResult<()> {
    let py = query.py();
    let (Answer::Reply { payload, .. } | Answer::Error(payload)) = answer else {
        return Ok(());
    };
    let (bytes, encoding) = parts(py, payload);
    let options = PyDict::new(py);
    options.set_item(intern!(py, "encoding"), encoding)?;
    match answer {
        Answer::Reply { key, .. } => {
            query.call_method(intern!(py, "reply"), (key, bytes), Some(&options))
        }
        _ => query.call_method(intern!(py, "reply_err"), (bytes,), Some(&options)),
    }
    .map(drop)
}

#[pymethods]
impl Execution {
    /// Handles the first reply on `key`, or the error (`None`). Returns the query that waits for it, too, and gets the same answer.
    fn on_result(
        &self,
        key: Option<String>,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> Option<Py<PyAny>> {
        let payload = payload(bytes, encoding);
        self.0.on_result(&match key {
            Some(key) => Answer::Reply { key, payload },
            None => Answer::Error(payload),
        })
    }
}

/// Creates the driver of a request to a robot. Raises `OptionError` if its timeout is too long.
#[pyfunction]
pub fn retried_request(
    py: Python<'_>,
    inquiry: &Inquiry,
    robot: &str,
    bytes: PyBackedBytes,
    encoding: &str,
    urgency: &str,
    catalogues: &Catalogues,
) -> PyResult<Driver> {
    let clock = Clock::new();
    let (payload, urgency) = (payload(bytes, encoding), urgency::parse(py, urgency)?);
    let inquiry = lock(&inquiry.0).clone();
    let timeout_s = inquiry.timeout().as_secs_f64();
    let request = RetriedRequest::new(
        clock.created_at(),
        inquiry,
        name(robot)?,
        payload,
        urgency,
        catalogues.0.clone(),
    );
    let request = request
        .map_err(|error| raised(py, "OptionError", ("timeout", timeout_s, error.to_string())));
    Ok(Driver::new(request?, &clock))
}

impl ToPython for Outcome {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let nothing = || (PyBytes::new(py, &[]), String::new());
        let outcome: KindParts<'_> = match self {
            Self::Replied(kind) => kind_parts(py, kind),
            Self::Plain => ("plain", None, nothing(), false),
            Self::Interrupted => ("interrupted", None, nothing(), false),
            Self::Closed => ("closed", None, nothing(), false),
        };
        outcome.into_py_any(py)
    }
}
