//! Exposes the requests of a program, the meaning of their replies, and the headers of the requests to its services.
use std::sync::Mutex;

use bytes::Bytes;
use pyo3::{
    intern,
    prelude::*,
    pybacked::PyBackedBytes,
    types::{PyBytes, PyTuple},
};
use rect_core::{
    catalogue::Instance,
    message::{
        encoding::Encoding,
        payload::Payload,
        request::{self, error_to_payload},
    },
    session::{
        inquiry::{self, ReplyKind},
        request_ids,
        served::{self, Unanswered},
        service,
    },
};

use crate::{
    codec::{parts, payload, Parts},
    driver::{bytes_of, get, lock, seconds},
    key_space::{name, AnyTopic, KeySpace},
    urgency,
};

/// The meaning of a reply: `answer` or `error`, each with the robot (`None` if it does not use RECT) and the payload, `timed_out`, or
/// `not_of_a_robot` with the key; and whether other programs of the robot may have received the request, too.
pub type KindParts<'py> = (&'static str, Option<String>, Parts<'py>, bool);

/// A request to services.
#[pyclass(frozen, module = "rect._rect")]
pub struct Inquiry(pub Mutex<inquiry::Inquiry>);

#[pymethods]
impl Inquiry {
    /// Creates a request to the service `topic` of a robot, or of all robots (`None`). `is_stream`: several replies are expected, and
    /// the mark of the last one.
    #[new]
    fn new(
        key_space: &KeySpace,
        robot: Option<&str>,
        topic: AnyTopic,
        timeout_s: f64,
        ids: &RequestIds,
        is_stream: bool,
    ) -> PyResult<Self> {
        let robot = robot.map(name).transpose()?;
        let place = key_space.0.clone();
        let AnyTopic(topic) = topic;
        let inquiry = inquiry::Inquiry::new(place, robot, topic, seconds(timeout_s), &ids.0);
        let inquiry = if is_stream { inquiry.stream() } else { inquiry };
        Ok(Self(Mutex::new(inquiry)))
    }

    /// Returns the query to send, as the step `get` of a driver.
    fn get<'py>(
        &self,
        py: Python<'py>,
        bytes: PyBackedBytes,
        encoding: &str,
        urgency: &str,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let urgency = urgency::parse(py, urgency)?;
        get(py, 0, lock(&self.0).get(payload(bytes, encoding), urgency))
    }

    /// Creates another request to the same service. Returns it with its attachment.
    fn another<'py>(
        &self,
        py: Python<'py>,
        timeout_s: f64,
        ids: &RequestIds,
    ) -> (Self, Bound<'py, PyBytes>) {
        let another = lock(&self.0).another(seconds(timeout_s), &ids.0);
        let attachment = PyBytes::new(py, &another.header().encode());
        (Self(Mutex::new(another)), attachment)
    }

    /// Returns the meaning of a reply of Zenoh; `None` for the mark that ends a stream.
    fn on_reply<'py>(
        &self,
        py: Python<'py>,
        reply: &Bound<'py, PyAny>,
    ) -> PyResult<Option<KindParts<'py>>> {
        let ok = reply.getattr(intern!(py, "ok"))?;
        let received = if ok.is_none() {
            let error = reply.getattr(intern!(py, "err"))?;
            Err(payload_of(&error)?)
        } else {
            let key = ok.getattr(intern!(py, "key_expr"))?.str()?.to_string();
            let attachment = ok.getattr(intern!(py, "attachment"))?;
            let attachment = if attachment.is_none() {
                None
            } else {
                let bytes: PyBackedBytes = bytes_of(&attachment)?.extract()?;
                Some(Bytes::from_owner(bytes))
            };
            Ok(rect_core::driver::Sample {
                key,
                payload: payload_of(&ok)?,
                attachment,
                is_deleted: false,
                priority: rect_core::driver::Sample::PRIORITY,
            })
        };
        let kind = lock(&self.0).on_reply(received);
        Ok(kind.map(|kind| kind_parts(py, kind)))
    }

    /// Description of the expected reply, for the text of a timeout.
    #[getter]
    fn expected(&self) -> String {
        lock(&self.0).expected()
    }

    /// Whether a service has replied.
    #[getter]
    fn is_started(&self) -> bool {
        lock(&self.0).is_started()
    }

    /// Whether the request is complete after its last reply.
    #[getter]
    fn is_complete(&self) -> bool {
        lock(&self.0).is_complete()
    }

    /// Handles that the program has closed the request. Returns the query that announces that, as the step `get` of a driver, if the
    /// service waits for it.
    fn close<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyTuple>>> {
        let closing = lock(&self.0).close();
        closing.map(|query| get(py, 0, query)).transpose()
    }
}

/// Converts the meaning of a reply.
pub fn kind_parts(py: Python<'_>, kind: ReplyKind) -> KindParts<'_> {
    let nothing = || (PyBytes::new(py, &[]), String::new());
    match kind {
        ReplyKind::Answer {
            sender,
            payload,
            is_shared,
        } => {
            let sender = Some(sender.to_string());
            ("answer", sender, parts(py, &payload), is_shared)
        }
        ReplyKind::Error { robot, payload } => {
            let robot = robot.map(|robot| robot.to_string());
            ("error", robot, parts(py, &payload), false)
        }
        ReplyKind::TimedOut => ("timed_out", None, nothing(), false),
        ReplyKind::NotOfARobot { key } => ("not_of_a_robot", Some(key), nothing(), false),
    }
}

/// The ids of the requests of one run of a program.
#[pyclass(frozen, module = "rect._rect")]
pub struct RequestIds(request_ids::RequestIds);

#[pymethods]
impl RequestIds {
    /// Creates the ids of a run. `is_announced`: the program has a name.
    #[new]
    fn new(run: u32, is_announced: bool) -> Self {
        Self(request_ids::RequestIds::new(Instance(run), is_announced))
    }
}

/// Whether somebody serves a key.
#[pyclass(frozen, module = "rect._rect")]
pub struct Served(served::Served);

/// The changes of `Served` until a request is sent.
#[pyclass(frozen, module = "rect._rect")]
pub struct Unsent(served::Unsent);

/// The knowledge about a request that was sent.
#[pyclass(frozen, module = "rect._rect")]
pub struct Sent(served::Sent);

#[pymethods]
impl Served {
    #[new]
    fn new() -> Self {
        Self(served::Served::default())
    }

    /// Handles a report of Zenoh.
    fn on_matching(&self, is_served: bool) {
        self.0.on_matching(is_served);
    }

    /// Whether somebody serves the key, as far as Zenoh has reported.
    #[getter]
    fn is_served(&self) -> bool {
        self.0.is_served()
    }

    /// Returns the state before a request is sent.
    fn unsent(&self) -> Unsent {
        Unsent(self.0.unsent())
    }

    /// Returns whether a request that ended without a reply may have been carried out.
    fn is_interrupted(&self, sent: &Sent) -> bool {
        self.0.unanswered(sent.0) == Unanswered::Interrupted
    }
}

#[pymethods]
impl Unsent {
    /// Returns the state after Zenoh has taken the request. `at_once`: Zenoh has ended it on the thread that sends it. `ask` asks Zenoh
    /// whether somebody serves the key now.
    fn taken(&self, at_once: bool, ask: &Bound<'_, PyAny>) -> PyResult<Sent> {
        let mut failed = None;
        let sent = self.0.taken(at_once, || {
            let answer = ask.call0().and_then(|answer| answer.extract());
            answer.unwrap_or_else(|error| {
                failed = Some(error);
                true
            })
        });
        failed.map_or(Ok(Sent(sent)), Err)
    }
}

/// Returns the attachment of the reply that ends a stream of replies.
#[pyfunction]
pub fn end_of_replies(py: Python<'_>, count: u32) -> Bound<'_, PyBytes> {
    PyBytes::new(py, &request::end_of_replies(count))
}

/// Returns the error reply of a robot to a request for which there is no room.
#[pyfunction]
pub fn busy_reply<'py>(py: Python<'py>, robot: &str) -> PyResult<Parts<'py>> {
    Ok(parts(py, &service::busy(&name(robot)?)))
}

/// Returns the encoding of an error reply of a robot. `encoding` is that of the error's payload.
#[pyfunction]
pub fn error_encoding(robot: &str, encoding: String) -> PyResult<String> {
    let error = Payload::new(Bytes::new(), Encoding::new(encoding));
    Ok(error_to_payload(&name(robot)?, error).encoding.to_string())
}

/// Returns the payload of a sample or an error reply of Zenoh.
fn payload_of(received: &Bound<'_, PyAny>) -> PyResult<Payload> {
    let py = received.py();
    let bytes = bytes_of(&received.getattr(intern!(py, "payload"))?)?;
    let encoding = received.getattr(intern!(py, "encoding"))?.str()?;
    Ok(payload(bytes.extract()?, &encoding.to_cow()?))
}
