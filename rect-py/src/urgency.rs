//! Converts urgencies between their names and the core's type, and to Zenoh's quality of service.
use pyo3::prelude::*;
use rect::core::urgency::{Qos, Urgency};

use crate::errors::raised;

const ALL: [(&str, Urgency); 3] = [
    ("urgent", Urgency::Urgent),
    ("normal", Urgency::Normal),
    ("bulk", Urgency::Bulk),
];

/// Zenoh's priority (1 to 7), whether a message is sent without batching, and whether a congested link drops it.
type QosFields = (u8, bool, bool);

/// Returns the quality of service of messages of that urgency.
#[pyfunction]
pub fn qos(py: Python<'_>, urgency: &str) -> PyResult<QosFields> {
    Ok(fields(parse(py, urgency)?.qos()))
}

/// Returns the quality of service of a stream's frames of that urgency.
#[pyfunction]
pub fn stream_qos(py: Python<'_>, urgency: &str) -> PyResult<QosFields> {
    Ok(fields(parse(py, urgency)?.qos().drop_when_congested()))
}

/// Returns whether messages of that urgency use a separate session with the router.
#[pyfunction]
pub fn uses_separate_session(py: Python<'_>, urgency: &str) -> PyResult<bool> {
    Ok(parse(py, urgency)?.uses_separate_session())
}

/// Returns the name of an urgency.
pub fn as_str(urgency: Urgency) -> &'static str {
    match urgency {
        Urgency::Urgent => "urgent",
        Urgency::Normal => "normal",
        Urgency::Bulk => "bulk",
    }
}

fn fields(qos: Qos) -> QosFields {
    (qos.priority, qos.express, qos.droppable)
}

fn parse(py: Python<'_>, text: &str) -> PyResult<Urgency> {
    let found = ALL.iter().find(|(name, _)| *name == text);
    found.map(|(_, urgency)| *urgency).ok_or_else(|| {
        let expected = "it must be \"urgent\", \"normal\" or \"bulk\"";
        raised(py, "OptionError", ("urgency", text, expected))
    })
}
