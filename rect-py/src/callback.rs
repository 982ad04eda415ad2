//! Defines the callbacks that Zenoh's threads call for each message and each request. They append the message or
//! request to a queue without running Python code.
use pyo3::{
    intern,
    prelude::*,
    types::{PyBytes, PyString},
};
use rect_core::{
    catalogue::Instance,
    message::Undelivered,
    session::service::{Requester, ServiceQuery},
};

use crate::{
    connection::Links,
    counters::AtomicCounters,
    driver::{bytes_of, is_delete, priority_of},
    message::{Inbound, MessageMetadata},
    queue::Queue,
    requester::OpenRequests,
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

/// The callback for the requests to a service. It appends a tuple to the queue: the query, its requester, the bytes and the encoding of
/// its payload, and the permission to carry it out, or `None`. For a queryable of another kind, it appends the query alone.
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
    open: OpenRequests,
    once: Py<Once>,
}

/// The fields of [`OfService`], as Python passes them.
type ServiceArguments = (u32, Py<PyAny>, Py<Once>);

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
        let priority = priority_of(sample)?;
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
    /// program, the function that is called when another program serves the topic, and what the program carries out at most once.
    #[new]
    #[pyo3(signature = (queue, on_refused, service=None))]
    fn new(queue: Py<Queue>, on_refused: Py<PyAny>, service: Option<ServiceArguments>) -> Self {
        let service = service.map(|(instance, on_taken_over, once)| OfService {
            instance: Instance(instance),
            on_taken_over,
            open: OpenRequests::default(),
            once,
        });
        Self {
            queue,
            on_refused,
            service,
        }
    }

    fn __call__(&self, py: Python<'_>, query: Py<PyAny>) -> PyResult<()> {
        let (query, item) = match &self.service {
            Some(service) => match service.admit(py, query)? {
                Some(admitted) => admitted,
                None => return Ok(()),
            },
            None => (query.clone_ref(py), query),
        };
        if !self.queue.get().push(py, item)? {
            self.on_refused.call1(py, (query,))?;
        }
        Ok(())
    }
}

impl OfService {
    /// Handles a query. Returns it with the item for the queue if the program is to carry it out.
    fn admit(&self, py: Python<'_>, query: Py<PyAny>) -> PyResult<Option<(Py<PyAny>, Py<PyAny>)>> {
        let bound = query.bind(py);
        let parameters = bound.getattr(intern!(py, "parameters"))?.str()?;
        let key = bound.getattr(intern!(py, "key_expr"))?;
        match ServiceQuery::of(&parameters.to_cow()?, self.instance) {
            ServiceQuery::Request => {
                let attachment = bound.getattr(intern!(py, "attachment"))?;
                let attachment = (!attachment.is_none())
                    .then(|| bytes_of(&attachment))
                    .transpose()?;
                let attachment = attachment.as_ref().map(|bytes| bytes.extract::<&[u8]>());
                let requester = Requester::of(&key.str()?.to_cow()?, attachment.transpose()?);
                if let Some(requester) = requester {
                    return self.admit_request(py, query, requester);
                }
            }
            ServiceQuery::Ping => {
                bound.call_method1(intern!(py, "reply"), (key, PyBytes::new(py, b"")))?;
            }
            ServiceQuery::TakenOver => {
                self.on_taken_over.call0(py)?;
            }
            ServiceQuery::Closed(id) => self.open.on_closed(py, id)?,
            ServiceQuery::OfAnother => {}
        }
        bound.call_method0(intern!(py, "drop"))?;
        Ok(None)
    }

    fn admit_request(
        &self,
        py: Python<'_>,
        query: Py<PyAny>,
        requester: Requester,
    ) -> PyResult<Option<(Py<PyAny>, Py<PyAny>)>> {
        let once = self.once.get();
        let Some((query, execution)) = once.admit(py, requester.header.as_ref(), query)? else {
            return Ok(None);
        };
        let bound = query.bind(py);
        let payload = bound.getattr(intern!(py, "payload"))?;
        let bytes = match payload.is_none() {
            true => PyBytes::new(py, b"").into_any(),
            false => bytes_of(&payload)?,
        };
        let encoding = bound.getattr(intern!(py, "encoding"))?;
        let encoding = match encoding.is_none() {
            true => intern!(py, "zenoh/bytes").clone(),
            false => encoding.str()?,
        };
        let requester = self.open.add(requester);
        let item = (bound, requester, bytes, encoding, execution)
            .into_pyobject(py)?
            .into_any()
            .unbind();
        Ok(Some((query, item)))
    }
}
