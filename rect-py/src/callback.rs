//! Owns the callbacks that Zenoh's threads call for each message and each request: they put it into a queue, without a line of
//! Python.
use std::time::Instant;

use pyo3::{intern, prelude::*};
use rect::core::key::NoMessage;

use crate::{connection::Links, counters::Counting, message::Inbound, queue::Queue};

/// For the messages of one key of a subscription. What it puts in: what the message says of itself, its payload, its
/// encoding, and by what it came where that is known.
#[pyclass(frozen, module = "rect._rect")]
pub struct OnMessage {
    queue: Py<Queue>,
    inbound: Py<Inbound>,
    counting: Py<Counting>,
    links: Option<Py<Links>>,
    directed: bool,
}

/// For the requests to a service. What it puts in: the query, and when it came.
#[pyclass(frozen, module = "rect._rect")]
pub struct OnRequest {
    queue: Py<Queue>,
    on_refused: Py<PyAny>,
}

/// A moment.
#[pyclass(frozen, module = "rect._rect")]
pub struct Moment(Instant);

#[pymethods]
impl OnMessage {
    #[new]
    fn new(
        queue: Py<Queue>,
        inbound: Py<Inbound>,
        counting: Py<Counting>,
        links: Option<Py<Links>>,
        directed: bool,
    ) -> Self {
        Self {
            queue,
            inbound,
            counting,
            links,
            directed,
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
        let said = self.inbound.get().on_delivered(
            &key.to_cow()?,
            attachment.transpose()?,
            priority,
            self.directed,
        );
        let counting = &self.counting.get().0;
        let said = match said {
            Ok(said) => said,
            Err(NoMessage::Elsewhere) => return Ok(()),
            Err(NoMessage::InvalidTopic { .. }) => {
                counting.on_rejected();
                return Ok(());
            }
        };
        let payload = bytes_of(&sample.getattr(intern!(py, "payload"))?)?;
        let encoding = sample.getattr(intern!(py, "encoding"))?.str()?;
        let over = self.links.as_ref();
        let over = over.and_then(|links| links.get().method_of(said.from()));
        counting.on_received(payload.len()?, said.missed());
        let item = (said, payload, encoding, over).into_pyobject(py)?;
        self.queue.get().push(py, item.into_any().unbind())?;
        Ok(())
    }
}

#[pymethods]
impl OnRequest {
    /// `on_refused` is given the query that finds too many before it.
    #[new]
    fn new(queue: Py<Queue>, on_refused: Py<PyAny>) -> Self {
        Self { queue, on_refused }
    }

    fn __call__(&self, py: Python<'_>, query: Py<PyAny>) -> PyResult<()> {
        let item = (query.clone_ref(py), Moment(Instant::now())).into_pyobject(py)?;
        if !self.queue.get().push(py, item.into_any().unbind())? {
            self.on_refused.call1(py, (query,))?;
        }
        Ok(())
    }
}

#[pymethods]
impl Moment {
    /// So many seconds ago.
    fn ago(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}

/// The bytes of a `ZBytes`.
fn bytes_of<'py>(zbytes: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    zbytes.call_method0(intern!(zbytes.py(), "to_bytes"))
}
