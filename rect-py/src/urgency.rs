//! Converts urgencies between their names and the core's type, and to Zenoh's quality of service.
use pyo3::prelude::*;
use rect_core::{
    message::urgency::Urgency,
    session::{
        publication,
        settings::{SessionChoice, SessionsState},
    },
};

use crate::{
    driver::{qos_fields, QosFields},
    errors::raised,
};

const ALL: [(&str, Urgency); 3] = [
    ("urgent", Urgency::Urgent),
    ("normal", Urgency::Normal),
    ("bulk", Urgency::Bulk),
];

/// Returns the quality of service of messages of that urgency that expire or not.
#[pyfunction]
pub fn qos(py: Python<'_>, urgency: &str, expires: bool) -> PyResult<QosFields> {
    Ok(qos_fields(publication::qos(parse(py, urgency)?, expires)))
}

/// Returns which session carries messages of that urgency: `normal`, `separate`, or `open` if the separate session is to
/// be opened now. `is_linked`: whether the normal session is linked with the router.
#[pyfunction]
pub fn choose_session(
    py: Python<'_>,
    urgency: &str,
    has_router: bool,
    is_open: bool,
    is_linked: bool,
) -> PyResult<&'static str> {
    let state = SessionsState {
        has_router,
        is_open,
        is_linked,
    };
    Ok(match state.choose(parse(py, urgency)?) {
        SessionChoice::Normal => "normal",
        SessionChoice::Separate => "separate",
        SessionChoice::Open => "open",
    })
}

/// Returns the name of an urgency.
pub fn as_str(urgency: Urgency) -> &'static str {
    match urgency {
        Urgency::Urgent => "urgent",
        Urgency::Normal => "normal",
        Urgency::Bulk => "bulk",
    }
}

/// Parses the name of an urgency. Raises `OptionError`.
pub fn parse(py: Python<'_>, text: &str) -> PyResult<Urgency> {
    let found = ALL.iter().find(|(name, _)| *name == text);
    found.map(|(_, urgency)| *urgency).ok_or_else(|| {
        let expected = "it must be \"urgent\", \"normal\" or \"bulk\"";
        raised(py, "OptionError", ("urgency", text, expected))
    })
}
