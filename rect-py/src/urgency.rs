//! Owns how urgent a message is, by the words that the core has for it.
use pyo3::prelude::*;
use rect::core::urgency::{Qos, Urgency};

use crate::errors::raised;

const ALL: [(&str, Urgency); 3] = [
    ("urgent", Urgency::Urgent),
    ("normal", Urgency::Normal),
    ("bulk", Urgency::Bulk),
];

/// Zenoh's priority, whether it is sent at once, and whether it is dropped where there is no room.
type Treated = (u8, bool, bool);

/// How Zenoh is to treat a message of that urgency.
#[pyfunction]
pub fn qos(py: Python<'_>, urgency: &str) -> PyResult<Treated> {
    Ok(treated(named(py, urgency)?.qos()))
}

/// How Zenoh is to treat a stream's frames of that urgency.
#[pyfunction]
pub fn qos_of_frames(py: Python<'_>, urgency: &str) -> PyResult<Treated> {
    Ok(treated(named(py, urgency)?.qos().newest_wins()))
}

/// Whether what is so urgent has a connection of its own to the router.
#[pyfunction]
pub fn goes_apart(py: Python<'_>, urgency: &str) -> PyResult<bool> {
    Ok(named(py, urgency)?.goes_apart())
}

/// The word for it.
pub fn word(urgency: Urgency) -> &'static str {
    match urgency {
        Urgency::Urgent => "urgent",
        Urgency::Normal => "normal",
        Urgency::Bulk => "bulk",
    }
}

fn treated(qos: Qos) -> Treated {
    (qos.priority, qos.express, qos.droppable)
}

fn named(py: Python<'_>, text: &str) -> PyResult<Urgency> {
    let known = ALL.iter().find(|(name, _)| *name == text);
    known.map(|(_, urgency)| *urgency).ok_or_else(|| {
        let known = "it is \"urgent\", \"normal\" or \"bulk\"";
        raised(py, "OptionError", ("urgency", text, known))
    })
}
