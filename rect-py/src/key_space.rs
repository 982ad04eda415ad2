//! Validates names, topics, patterns and encodings, and makes keys from them.
use pyo3::{prelude::*, pybacked::PyBackedStr};
use rect_core::{
    action, codec,
    message::{encoding::Encoding, payload::PayloadError, urgency::Urgency},
    name::{
        key,
        topic::{Pattern, Topic},
        Name,
    },
    parameters,
    session::publication::PublicationKey,
};

use crate::errors::{raised, OrRaise};

/// The keys that a program of one robot uses.
#[pyclass(frozen, module = "rect._rect")]
pub struct KeySpace(pub key::KeySpace);

/// A topic that RECT itself serves. No text names it.
#[pyclass(frozen, module = "rect._rect")]
pub struct InternalTopic(Topic);

/// A topic of the Python code: a text, which is validated, or an internal topic.
pub struct AnyTopic(pub Topic);

impl<'a, 'py> FromPyObject<'a, 'py> for AnyTopic {
    type Error = PyErr;

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        match object.cast::<InternalTopic>() {
            Ok(internal) => Ok(Self(internal.get().0.clone())),
            Err(_) => topic(&object.extract::<PyBackedStr>()?).map(Self),
        }
    }
}

#[pymethods]
impl InternalTopic {
    /// Returns the topic at which a group of parameters is changed. Raises `ParameterError`.
    #[staticmethod]
    fn of_parameters(py: Python<'_>, group: &str) -> PyResult<Self> {
        let topic = Topic::of_parameters(group).map(Self);
        topic.ok_or_else(|| raised(py, "ParameterError", (parameters::wrong_group(group),)))
    }

    /// Returns the topic at which an action is served. Raises `InvalidTopicError`.
    #[staticmethod]
    fn of_action(py: Python<'_>, action: &str) -> PyResult<Self> {
        let topic = Topic::of_action(action).map(Self);
        topic.ok_or_else(|| raised(py, "InvalidTopicError", (action::wrong_action(action),)))
    }

    fn __str__(&self) -> &str {
        self.0.as_str()
    }
}

/// Validates the name of a robot or fleet.
pub fn name(text: &str) -> PyResult<Name> {
    Name::new(text).or_raise()
}

/// Validates a topic.
pub fn topic(text: &str) -> PyResult<Topic> {
    Topic::new(text).or_raise()
}

/// Validates patterns.
pub fn patterns(texts: &[String]) -> PyResult<Vec<Pattern>> {
    let patterns = texts.iter().map(|text| Pattern::new(text));
    patterns.collect::<Result<_, _>>().or_raise()
}

/// Raises `InvalidNameError` unless the text is a valid name of a robot or fleet.
#[pyfunction]
pub fn check_name(text: &str) -> PyResult<()> {
    name(text).map(drop)
}

/// Raises `InvalidTopicError` unless the text is a valid topic.
#[pyfunction]
pub fn check_topic(text: &str) -> PyResult<()> {
    topic(text).map(drop)
}

/// Splits a pattern into the robot (`None` for any) and the topic, in canonical form. Raises `InvalidTopicError` and
/// `InvalidNameError`.
#[pyfunction]
pub fn pattern(text: &str) -> PyResult<(Option<String>, String)> {
    let pattern = Pattern::new(text).or_raise()?;
    let robot = pattern.robot().map(Name::to_string);
    Ok((robot, pattern.topic().to_owned()))
}

/// Returns what a payload with this encoding is: `json`, `cbor`, `text`, `png`, `jpeg`, `webp`, `h264`, `raw` or `other`.
#[pyfunction]
pub fn encoding_kind(text: &str) -> &'static str {
    Encoding::new(text.to_owned()).kind().as_str()
}

/// Returns the media type and the schema of an encoding, and the encoding without its suffix `;zstd` (`None` if it has
/// no such suffix).
#[pyfunction]
pub fn encoding_parts(text: &str) -> (String, Option<String>, Option<String>) {
    let encoding = Encoding::new(text.to_owned());
    (
        encoding.media_type().to_owned(),
        encoding.schema().map(str::to_owned),
        encoding
            .without_suffix(codec::zstd::NAME)
            .map(|encoding| encoding.to_string()),
    )
}

/// Raises `PayloadError` unless a payload with that encoding can be sent.
#[pyfunction]
pub fn check_encoding(text: &str) -> PyResult<()> {
    let checked = Encoding::new(text.to_owned()).check_length();
    checked.map_err(PayloadError::from).or_raise()
}

#[pymethods]
impl KeySpace {
    #[new]
    fn new(fleet: &str, robot: &str) -> PyResult<Self> {
        let (fleet, robot) = (name(fleet)?, name(robot)?);
        Ok(Self(key::KeySpace { fleet, robot }))
    }

    #[getter]
    fn fleet(&self) -> &str {
        self.0.fleet.as_str()
    }

    #[getter]
    fn robot(&self) -> &str {
        self.0.robot.as_str()
    }

    /// Returns the key under which this robot publishes on a topic or serves it, or the key of its messages to one robot.
    #[pyo3(signature = (topic, recipient=None))]
    fn publication(&self, topic: AnyTopic, recipient: Option<&str>) -> PyResult<String> {
        let key = PublicationKey {
            topic: topic.0,
            recipient: recipient.map(name).transpose()?,
            urgency: Urgency::default(),
            expires: false,
        };
        Ok(key.key(&self.0))
    }

    /// Returns the key of a service of a robot, or of all robots (`None`).
    fn service(&self, robot: Option<&str>, topic: &str) -> PyResult<String> {
        let robot = robot.map(name).transpose()?;
        Ok(self.0.service(robot.as_ref(), &self::topic(topic)?))
    }

    /// Returns a key that is reserved for RECT, `@rect/<rest>`, of a robot, or of all robots (`None`).
    fn own(&self, robot: Option<&str>, rest: &str) -> PyResult<String> {
        let robot = robot.map(name).transpose()?;
        Ok(self.0.own(robot.as_ref(), rest))
    }

    /// Returns the robot that a key belongs to. Returns `None` if the key is not one of this fleet.
    fn robot_of(&self, key: &str) -> Option<String> {
        self.0.robot_of(key).map(|name| name.to_string())
    }

    /// Splits the key of a message into the sender, the recipient (`None` for a published message) and the topic.
    /// Returns `None` if the key is not that of a message, or if the message is for another robot.
    fn address(&self, key: &str) -> Option<(String, Option<String>, String)> {
        let address = self.0.address(key)?;
        let recipient = address.recipient.map(|name| name.to_string());
        Some((
            address.sender.to_string(),
            recipient,
            address.topic.to_string(),
        ))
    }

    fn __repr__(&self) -> String {
        format!("KeySpace({}/{})", self.0.fleet, self.0.robot)
    }
}
