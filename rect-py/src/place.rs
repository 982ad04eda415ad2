//! Owns names, topics, patterns, keys and encodings: what is called how.
use pyo3::prelude::*;
use rect::core::{
    codec,
    encoding::Encoding,
    key,
    name::Name,
    payload::PayloadError,
    stream::{self, Group},
    topic::{Pattern, Topic},
};

use crate::errors::OrRaise;

/// The keys of a program of a robot.
#[pyclass(frozen, module = "rect._rect")]
pub struct Place(pub key::Place);

/// A name, checked.
pub fn name(text: &str) -> PyResult<Name> {
    Name::new(text).or_raise()
}

/// A topic, checked.
pub fn topic(text: &str) -> PyResult<Topic> {
    Topic::new(text).or_raise()
}

/// Raises unless the text may name a robot or a fleet.
#[pyfunction]
pub fn check_name(text: &str) -> PyResult<()> {
    name(text).map(drop)
}

/// Raises unless the text may be a topic.
#[pyfunction]
pub fn check_topic(text: &str) -> PyResult<()> {
    topic(text).map(drop)
}

/// The robot (`None`: any) and the topic of a pattern, in canonical form.
#[pyfunction]
pub fn pattern(text: &str) -> PyResult<(Option<String>, String)> {
    let pattern = Pattern::new(text).or_raise()?;
    let robot = pattern.robot().map(Name::to_string);
    Ok((robot, pattern.topic().to_owned()))
}

/// The pattern of what a robot says about a topic, which may have wildcards.
#[pyfunction]
pub fn pattern_of(robot: &str, topic: &str) -> PyResult<String> {
    let pattern = Pattern::of(Some(name(robot)?), topic).or_raise()?;
    Ok(pattern.to_string())
}

/// The media type of an encoding, what is after it, and what it is once zstd is undone.
#[pyfunction]
pub fn encoding_parts(text: &str) -> (String, Option<String>, Option<String>) {
    let encoding = Encoding::new(text.to_owned());
    (
        encoding.media_type().to_owned(),
        encoding.schema().map(str::to_owned),
        encoding
            .unpacked(codec::zstd::NAME)
            .map(|below| below.to_string()),
    )
}

/// Whether a payload of that encoding is packed: its codec is to be undone.
#[pyfunction]
pub fn is_packed(text: &str) -> bool {
    codec::is_packed(&Encoding::new(text.to_owned()))
}

/// Raises unless a payload with that encoding can be sent.
#[pyfunction]
pub fn check_encoding(text: &str) -> PyResult<()> {
    let checked = Encoding::new(text.to_owned()).check_length();
    checked.map_err(PayloadError::from).or_raise()
}

#[pymethods]
impl Place {
    #[new]
    fn new(fleet: &str, robot: &str) -> PyResult<Self> {
        let (fleet, robot) = (name(fleet)?, name(robot)?);
        Ok(Self(key::Place { fleet, robot }))
    }

    #[getter]
    fn fleet(&self) -> &str {
        self.0.fleet.as_str()
    }

    #[getter]
    fn robot(&self) -> &str {
        self.0.robot.as_str()
    }

    /// The key of what this robot says to all, and of its service.
    fn publication(&self, about: &str) -> PyResult<String> {
        Ok(self.0.publication(&topic(about)?))
    }

    /// The key of what it says to one robot.
    fn message(&self, robot: &str, about: &str) -> PyResult<String> {
        Ok(self.0.message(&name(robot)?, &topic(about)?))
    }

    /// The key of a service of a robot, or of all (`None`).
    fn service(&self, robot: Option<&str>, about: &str) -> PyResult<String> {
        let robot = robot.map(name).transpose()?;
        Ok(self.0.service(robot.as_ref(), &topic(about)?))
    }

    /// A key of RECT's own, of a robot or of all (`None`).
    fn own(&self, robot: Option<&str>, rest: &str) -> PyResult<String> {
        let robot = robot.map(name).transpose()?;
        Ok(self.0.own(robot.as_ref(), rest))
    }

    /// The key expressions of a pattern: what is said to all, and to this robot alone.
    fn subscriptions(&self, pattern: &str) -> PyResult<(String, String)> {
        let pattern = Pattern::new(pattern).or_raise()?;
        let [all, mine] = self.0.subscriptions(&pattern);
        Ok((all, mine))
    }

    /// Whose a key is; `None`: not one of this fleet.
    fn robot_of(&self, key: &str) -> Option<String> {
        self.0.robot_of(key).map(|name| name.to_string())
    }

    /// Who says it, to whom alone, and about what; `None`: no message, or one for another robot.
    fn address(&self, key: &str) -> Option<(String, Option<String>, String)> {
        let address = self.0.address(key)?;
        let to = address.to.map(|to| to.to_string());
        Some((address.from.to_string(), to, address.topic.to_string()))
    }

    /// The key of a stream's frames, for the group of that number.
    fn frames(&self, sender: &str, about: &str, group: usize) -> PyResult<String> {
        let place = self.of(sender)?;
        let group = Group::ALL.get(group).copied().unwrap_or_default();
        Ok(group.key(&place, &topic(about)?))
    }

    /// The key of what a sender says of its stream.
    fn notice(&self, sender: &str, about: &str) -> PyResult<String> {
        Ok(stream::notice_key(&self.of(sender)?, &topic(about)?))
    }

    /// The key of what this robot says of a sender's stream.
    fn feedback(&self, sender: &str, about: &str) -> PyResult<String> {
        Ok(stream::feedback_key(
            &self.0,
            &name(sender)?,
            &topic(about)?,
        ))
    }

    /// The key expression of what all say of this robot's stream.
    fn feedbacks(&self, about: &str) -> PyResult<String> {
        Ok(stream::feedback_keys(&self.0, &topic(about)?))
    }

    fn __repr__(&self) -> String {
        format!("Place({}/{})", self.0.fleet, self.0.robot)
    }
}

impl Place {
    fn of(&self, robot: &str) -> PyResult<key::Place> {
        let fleet = self.0.fleet.clone();
        let robot = name(robot)?;
        Ok(key::Place { fleet, robot })
    }
}
