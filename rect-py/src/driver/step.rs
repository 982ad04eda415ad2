//! Converts the steps of drivers to tuples. The first element is the name of the step, after which the executor's method
//! is named that performs it.
use std::time::Instant;

use pyo3::{
    prelude::*,
    types::{PyBytes, PyTuple},
};
use rect_core::{
    driver::{Action, Answer, Declaration, Get, Step, Target},
    message::{payload::Payload, urgency::Qos},
};

use super::fields::ToPython;
use crate::codec::{parts, Parts};

/// Zenoh's priority (1 to 7), whether a message is sent without batching, and whether a congested link drops it.
pub type QosFields = (u8, bool, bool);

/// Converts a quality of service.
pub fn qos_fields(qos: Qos) -> QosFields {
    (qos.priority, qos.express, qos.droppable)
}

pub fn step<'py, I: ToPython, O: ToPython>(
    py: Python<'py>,
    step: Step<I, O>,
    now: Instant,
) -> PyResult<Bound<'py, PyTuple>> {
    match step {
        Step::Act(action) => act(py, action),
        Step::Deliver(item) => ("deliver", item.to_python(py)?).into_pyobject(py),
        Step::Wait(until) => {
            let until = until.map(|until| until.saturating_duration_since(now).as_secs_f64());
            ("wait", until).into_pyobject(py)
        }
        Step::Finished(output) => ("finished", output.to_python(py)?).into_pyobject(py),
    }
}

/// Converts an action.
pub fn act(py: Python<'_>, action: Action) -> PyResult<Bound<'_, PyTuple>> {
    match action {
        Action::Declare { id, declaration } => declare(py, id.0, declaration),
        Action::Undeclare { id } => ("undeclare", id.0).into_pyobject(py),
        Action::Put {
            publisher,
            payload,
            attachment,
        } => {
            let (bytes, encoding) = parts(py, &payload);
            let attachment = attachment.map(|bytes| PyBytes::new(py, &bytes));
            ("put", publisher.0, bytes, encoding, attachment).into_pyobject(py)
        }
        Action::PutOnce { key, payload, qos } => {
            let (bytes, encoding) = parts(py, &payload);
            ("put_once", key, bytes, encoding, qos_fields(qos)).into_pyobject(py)
        }
        Action::PutRetained {
            key,
            payload,
            qos,
            attachment,
            ..
        } => {
            let payload = payload.as_ref().map(|payload| parts(py, payload));
            let attachment = PyBytes::new(py, &attachment);
            ("put_retained", key, payload, qos_fields(qos), attachment).into_pyobject(py)
        }
        Action::AnswerRetained { query, replies } => {
            let replies = replies.iter().map(|reply| {
                let attachment = PyBytes::new(py, &reply.attachment);
                (reply.key.as_str(), parts(py, &reply.payload), attachment)
            });
            let replies: Vec<_> = replies.collect();
            ("answer_retained", query.0, replies).into_pyobject(py)
        }
        Action::Get { id, get } if get.liveliness => {
            let timeout = get.timeout.as_secs_f64();
            ("get_liveliness", id.0, get.selector, timeout).into_pyobject(py)
        }
        Action::Get { id, get } => self::get(py, id.0, get),
        Action::Answer { query, answer } => match answer {
            Answer::Reply { key, payload } => {
                let (bytes, encoding) = parts(py, &payload);
                ("reply", query.0, key, bytes, encoding).into_pyobject(py)
            }
            Answer::Error(payload) => {
                let (bytes, encoding) = parts(py, &payload);
                ("reply_error", query.0, bytes, encoding).into_pyobject(py)
            }
            Answer::None => ("end_query", query.0).into_pyobject(py),
        },
    }
}

/// Converts a query for data.
pub fn get(py: Python<'_>, id: u64, get: Get) -> PyResult<Bound<'_, PyTuple>> {
    let payload = get.payload.as_ref();
    let payload: Option<Parts<'_>> = payload.map(|payload: &Payload| parts(py, payload));
    let attachment = get.attachment.map(|bytes| PyBytes::new(py, &bytes));
    (
        "get",
        id,
        get.selector,
        payload,
        attachment,
        qos_fields(get.qos),
        get.target == Target::All,
        get.timeout.as_secs_f64(),
    )
        .into_pyobject(py)
}

fn declare(py: Python<'_>, id: u64, declaration: Declaration) -> PyResult<Bound<'_, PyTuple>> {
    match declaration {
        Declaration::Publisher {
            key,
            qos,
            observes_matching,
        } => {
            let qos = qos_fields(qos);
            ("declare_publisher", id, key, qos, observes_matching).into_pyobject(py)
        }
        Declaration::Subscriber { key } => ("declare_subscriber", id, key).into_pyobject(py),
        Declaration::Queryable { key, complete } => {
            ("declare_queryable", id, key, complete).into_pyobject(py)
        }
        Declaration::LivelinessToken { key } => ("declare_token", id, key).into_pyobject(py),
        Declaration::LivelinessSubscriber { key } => {
            ("declare_liveliness_subscriber", id, key).into_pyobject(py)
        }
        Declaration::LinkListener => ("declare_link_listener", id).into_pyobject(py),
    }
}
