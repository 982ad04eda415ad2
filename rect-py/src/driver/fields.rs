//! Converts the items and outputs of drivers to Python objects.
use std::convert::Infallible;

use bytes::Bytes;
use pyo3::{
    prelude::*,
    pybacked::PyBackedBytes,
    types::{PyBytes, PyTuple},
    IntoPyObjectExt,
};
use rect_core::{
    catalogue::registration::Registered,
    driver::Sample,
    message::payload::Payload,
    name::Name,
    registry::{
        connection::{Connection, Event},
        servers_query, RegistryError,
    },
    session::peers::Waited,
    stream::frame::ReceivedFrame,
    transfer::Progress,
};
use rect_recording::report::EventReport;

use crate::codec::parts;

/// A value that a driver delivers, or with which it finishes.
pub trait ToPython: Send {
    /// Converts the value.
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>>;
}

/// A report of the connections of a router, for `Links`.
#[pyclass(frozen, module = "rect._rect")]
pub struct ConnectionsReport(pub Vec<Connection>);

#[pymethods]
impl ConnectionsReport {
    fn __repr__(&self) -> String {
        format!("{} connections", self.0.len())
    }
}

pub fn sample(
    key: String,
    payload: Payload,
    attachment: Option<PyBackedBytes>,
    is_deleted: bool,
    priority: u8,
) -> Sample {
    Sample {
        key,
        payload,
        attachment: attachment.map(Bytes::from_owner),
        is_deleted,
        priority,
    }
}

impl ToPython for Infallible {
    fn to_python(self, _: Python<'_>) -> PyResult<Py<PyAny>> {
        match self {}
    }
}

impl ToPython for () {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        Ok(py.None())
    }
}

impl ToPython for String {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        self.into_py_any(py)
    }
}

impl ToPython for Vec<Name> {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let names: Vec<&str> = self.iter().map(Name::as_str).collect();
        names.into_py_any(py)
    }
}

/// The robots that serve a topic. Two answers are equal if no program has begun, ended or changed its services between them.
#[pyclass(frozen, eq, module = "rect._rect")]
#[derive(PartialEq)]
pub struct Servers(servers_query::Servers);

#[pymethods]
impl Servers {
    /// Names of the robots.
    #[getter]
    fn robots(&self) -> Vec<String> {
        self.0.robots.iter().map(ToString::to_string).collect()
    }
}

impl ToPython for Option<servers_query::Servers> {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        self.map(Servers).into_py_any(py)
    }
}

impl ToPython for Waited {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let text = match self {
            Self::Ready => "ready",
            Self::TimedOut => "timed_out",
            Self::Closed => "closed",
        };
        text.into_py_any(py)
    }
}

impl ToPython for Result<Payload, RegistryError> {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        match self {
            Ok(payload) => ("answer", parts(py, &payload)).into_py_any(py),
            Err(RegistryError::Rejected(payload)) => {
                ("rejected", parts(py, &payload)).into_py_any(py)
            }
            Err(RegistryError::TimedOut { expected }) => ("timed_out", expected).into_py_any(py),
            Err(RegistryError::NoService { service, available }) => {
                let available = available.to_python(py)?;
                ("no_service", (service, available)).into_py_any(py)
            }
            Err(RegistryError::Closed) => ("closed", py.None()).into_py_any(py),
        }
    }
}

impl ToPython for Registered {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        match self {
            Self::Accepted(warning) => ("accepted", warning),
            Self::Refused(reason) => ("refused", Some(reason)),
            Self::Unanswered => ("unanswered", None),
            Self::Closed => ("closed", None),
        }
        .into_py_any(py)
    }
}

impl ToPython for ReceivedFrame {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let age = self.age.map(|age| age.as_secs_f64());
        let bytes = PyBytes::new(py, &self.payload.bytes);
        let encoding = self.payload.encoding.as_str();
        (self.ordinal, self.lost, self.number, age, bytes, encoding).into_py_any(py)
    }
}

impl ToPython for Event {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let report = EventReport::from(&self);
        PyTuple::new(py, report.fields())?.into_py_any(py)
    }
}

impl ToPython for Vec<Connection> {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        ConnectionsReport(self).into_py_any(py)
    }
}

impl ToPython for Progress {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        (self.received_bytes, self.size_bytes).into_py_any(py)
    }
}
