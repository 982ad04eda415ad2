//! Defines the callbacks that Zenoh's threads call for each message and each request. They append the message or
//! request to a queue without running Python code.
use std::time::Instant;

use pyo3::{
    intern,
    prelude::*,
    types::{PyBytes, PyString},
};
use rect_core::{catalogue::Instance, message::Undelivered, session::service::ServiceQuery};

use crate::{
    connection::Links,
    counters::AtomicCounters,
    driver::{bytes_of, is_delete},
    message::{Inbound, MessageMetadata},
    queue::Queue,
    retry::Once,
};

/// The callback for the messages of one Zenoh subscriber of a subscription. It appends a tuple to the queue: the
/// metadata, the payload, the encoding, and the method of the link (`None` if it is unknown).
#[pyclass(frozen, module = "rect._rect")]
pub struct OnMessage {
    queue: Py<Queue>,
    inbound: Py<Inbound>,
    counters: Py<AtomicCounters>,
    links: Option<Py<Links>>,
    subscription: usize,
}

/// The callback for the requests to a service. It appends each query with its time of arrival to the queue; those to a service also with
/// the permission to carry them out, or `None`.
#[pyclass(frozen, module = "rect._rect")]
pub struct OnRequest {
    queue: Py<Queue>,
    on_refused: Py<PyAny>,
    /// `None` for a queryable of another kind.
    service: Option<OfService>,
}

/// The part of the program in the requests to its services.
struct OfService {
    /// The run of the program.
    instance: Instance,
    /// The function to call when another program serves the topic.
    on_taken_over: Py<PyAny>,
    /// The function to call with the id of a request that its requester has closed.
    on_closed: Py<PyAny>,
    once: Py<Once>,
}

/// The fields of [`OfService`], as Python passes them.
type ServiceArguments = (u32, Py<PyAny>, Py<PyAny>, Py<Once>);

/// A point in time.
#[pyclass(frozen, module = "rect._rect")]
pub struct Timestamp(Instant);

#[pymethods]
impl OnMessage {
    #[new]
    fn new(
        queue: Py<Queue>,
        inbound: Py<Inbound>,
        counters: Py<AtomicCounters>,
        links: Option<Py<Links>>,
        subscription: usize,
    ) -> Self {
        Self {
            queue,
            inbound,
            counters,
            links,
            subscription,
        }
    }

    fn __call__(&self, py: Python<'_>, sample: &Bound<'_, PyAny>) -> PyResult<()> {
        let key = sample.getattr(intern!(py, "key_expr"))?.str()?;
        let attachment = sample.getattr(intern!(py, "attachment"))?;
        let attachment = (!attachment.is_none())
            .then(|| bytes_of(&attachment))
            .transpose()?;
        let attachment = attachment.as_ref().map(|bytes| bytes.extract::<&[u8]>());
        let priority = sample.getattr(intern!(py, "priority"))?;
        let priority: u8 = priority.call_method0(intern!(py, "__int__"))?.extract()?;
        let kind = sample.getattr(intern!(py, "kind"))?;
        let is_deleted = is_delete(&kind)?;
        let metadata = self.inbound.get().on_delivery(
            &key.to_cow()?,
            attachment.transpose()?,
            priority,
            is_deleted,
            self.subscription,
        );
        let counters = &self.counters.get().0;
        let metadata = match metadata {
            Ok(metadata) => metadata,
            Err(Undelivered::Expired { missed }) => {
                counters.on_expired(missed);
                return Ok(());
            }
            Err(Undelivered::NotSelected) => return Ok(()),
            Err(Undelivered::InvalidTopic) => {
                counters.on_rejected();
                return Ok(());
            }
        };
        let payload = bytes_of(&sample.getattr(intern!(py, "payload"))?)?;
        let encoding = sample.getattr(intern!(py, "encoding"))?.str()?;
        self.push(py, metadata, &payload, &encoding)
    }
}

impl OnMessage {
    /// Returns the state of the subscription.
    pub fn inbound(&self) -> &Inbound {
        self.inbound.get()
    }

    /// Counts a message, and appends it to the queue.
    pub fn push(
        &self,
        py: Python<'_>,
        metadata: MessageMetadata,
        payload: &Bound<'_, PyAny>,
        encoding: &Bound<'_, PyString>,
    ) -> PyResult<()> {
        let links = self.links.as_ref();
        let method = links.and_then(|links| links.get().method_of(metadata.sender_name()));
        let counters = &self.counters.get().0;
        counters.on_received(payload.len()?, metadata.missed());
        let item = (metadata, payload, encoding, method).into_pyobject(py)?;
        self.queue.get().push(py, item.into_any().unbind())?;
        Ok(())
    }
}

#[pymethods]
impl OnRequest {
    /// Creates the callback. `on_refused` is called with a query that arrives while the queue is full. `service` is the run of the
    /// program, the functions that are called when another program serves the topic, and when a requester has closed the request of an
    /// id, and what the program carries out at most once.
    #[new]
    #[pyo3(signature = (queue, on_refused, service=None))]
    fn new(queue: Py<Queue>, on_refused: Py<PyAny>, service: Option<ServiceArguments>) -> Self {
        let service = service.map(|(instance, on_taken_over, on_closed, once)| OfService {
            instance: Instance(instance),
            on_taken_over,
            on_closed,
            once,
        });
        Self {
            queue,
            on_refused,
            service,
        }
    }

    fn __call__(&self, py: Python<'_>, query: Py<PyAny>) -> PyResult<()> {
        let arrived_at = Timestamp(Instant::now());
        let (query, item) = if let Some(service) = &self.service {
            let parameters = query.getattr(py, intern!(py, "parameters"))?;
            let meaning = ServiceQuery::of(&parameters.bind(py).str()?.to_cow()?, service.instance);
            match meaning {
                ServiceQuery::Request => {}
                ServiceQuery::Ping => {
                    let key = query.getattr(py, intern!(py, "key_expr"))?;
                    query.call_method1(py, intern!(py, "reply"), (key, PyBytes::new(py, b"")))?;
                }
                ServiceQuery::TakenOver => {
                    service.on_taken_over.call0(py)?;
                }
                ServiceQuery::Closed(id) => {
                    service.on_closed.call1(py, (id.to_string(),))?;
                }
                ServiceQuery::OfAnother => {}
            }
            if meaning != ServiceQuery::Request {
                query.call_method0(py, intern!(py, "drop"))?;
                return Ok(());
            }
            let Some((query, execution)) = service.once.get().admit(py, query)? else {
                return Ok(());
            };
            let item = (query.clone_ref(py), arrived_at, execution).into_pyobject(py)?;
            (query, item.into_any())
        } else {
            let item = (query.clone_ref(py), arrived_at).into_pyobject(py)?;
            (query, item.into_any())
        };
        if !self.queue.get().push(py, item.unbind())? {
            self.on_refused.call1(py, (query,))?;
        }
        Ok(())
    }
}

#[pymethods]
impl Timestamp {
    /// Returns the time since this point, in seconds.
    fn ago(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}
