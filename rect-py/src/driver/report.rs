//! Defines the callbacks that Zenoh's threads call for the declarations and queries of a driver. They report to the
//! driver without running Python code: that would cost more, and a Ctrl-C in it would be lost inside Zenoh.
use pyo3::{intern, prelude::*, types::PyDict};
use rect_core::driver::MAX_OPEN_QUERIES;

use super::{Driver, Reaction};

/// A callback for one declaration or query of a driver.
#[pyclass(frozen, module = "rect._rect")]
pub struct Report {
    driver: Py<Driver>,
    id: u64,
    /// Called with each item that the driver delivers.
    deliver: Option<Py<PyAny>>,
    /// Called with `None` if the driver is to be polled.
    wake: Option<Py<PyAny>>,
    /// The queries that are not answered yet, by their numbers.
    queries: Py<PyDict>,
}

#[pymethods]
impl Report {
    #[new]
    fn new(
        driver: Py<Driver>,
        id: u64,
        deliver: Option<Py<PyAny>>,
        wake: Option<Py<PyAny>>,
        queries: Py<PyDict>,
    ) -> Self {
        Self {
            driver,
            id,
            deliver,
            wake,
            queries,
        }
    }

    /// Reports a sample.
    fn sample(&self, py: Python<'_>, sample: &Bound<'_, PyAny>) -> PyResult<()> {
        let key = text(sample, intern!(py, "key_expr"))?;
        let bytes = bytes_of(&sample.getattr(intern!(py, "payload"))?)?;
        let encoding = text(sample, intern!(py, "encoding"))?;
        let attachment = sample.getattr(intern!(py, "attachment"))?;
        let attachment = match attachment.is_none() {
            true => None,
            false => Some(bytes_of(&attachment)?.extract()?),
        };
        let kind = sample.getattr(intern!(py, "kind"))?;
        let is_deleted = is_delete(&kind)?;
        let priority = priority_of(sample)?;
        let bytes = bytes.extract()?;
        let reaction = self.driver.get().on_sample(
            py, self.id, key, bytes, &encoding, attachment, is_deleted, priority,
        )?;
        self.react(py, reaction)
    }

    /// Reports a reply.
    fn reply(&self, py: Python<'_>, reply: &Bound<'_, PyAny>) -> PyResult<()> {
        let driver = self.driver.get();
        let ok = reply.getattr(intern!(py, "ok"))?;
        let reaction = if ok.is_none() {
            let error = reply.getattr(intern!(py, "err"))?;
            let bytes = bytes_of(&error.getattr(intern!(py, "payload"))?)?;
            let encoding = text(&error, intern!(py, "encoding"))?;
            driver.on_error(py, self.id, bytes.extract()?, &encoding)?
        } else {
            let bytes = bytes_of(&ok.getattr(intern!(py, "payload"))?)?;
            let (key, encoding) = (
                text(&ok, intern!(py, "key_expr"))?,
                text(&ok, intern!(py, "encoding"))?,
            );
            driver.on_reply(py, self.id, key, bytes.extract()?, &encoding)?
        };
        self.react(py, reaction)
    }

    /// Reports the end of a query.
    fn ended(&self, py: Python<'_>) -> PyResult<()> {
        self.react(py, self.driver.get().on_ended(py, self.id)?)
    }

    /// Reports a query, and keeps it until it is answered. Beyond the limit it ends without an answer.
    fn query(&self, py: Python<'_>, query: &Bound<'_, PyAny>) -> PyResult<()> {
        let queries = self.queries.bind(py);
        if queries.len() >= MAX_OPEN_QUERIES {
            query.call_method0(intern!(py, "drop"))?;
            return Ok(());
        }
        let payload = query.getattr(intern!(py, "payload"))?;
        let encoding = query.getattr(intern!(py, "encoding"))?;
        let (bytes, encoding) = match payload.is_none() {
            true => (pyo3::types::PyBytes::new(py, &[]).into_any(), None),
            false => (bytes_of(&payload)?, Some(encoding.str()?.to_string())),
        };
        let key = text(query, intern!(py, "key_expr"))?;
        let attachment = query.getattr(intern!(py, "attachment"))?;
        let attachment = match attachment.is_none() {
            true => None,
            false => Some(bytes_of(&attachment)?.extract()?),
        };
        let number = query.as_ptr() as u64;
        queries.set_item(number, query)?;
        let encoding = encoding.as_deref().unwrap_or("zenoh/bytes");
        let driver = self.driver.get();
        self.react(
            py,
            driver.on_query(
                py,
                self.id,
                number,
                bytes.extract()?,
                encoding,
                key,
                attachment,
            )?,
        )
    }

    /// Reports whether subscribers match a publisher.
    fn matching(&self, py: Python<'_>, status: &Bound<'_, PyAny>) -> PyResult<()> {
        let matching = status.getattr(intern!(py, "matching"))?.extract()?;
        self.react(py, self.driver.get().on_matching(py, self.id, matching)?)
    }

    /// Reports a link that came up or went down.
    fn link(&self, py: Python<'_>, event: &Bound<'_, PyAny>) -> PyResult<()> {
        let up = !is_delete(&event.getattr(intern!(py, "kind"))?)?;
        let link = event.getattr(intern!(py, "link"))?;
        let locator = text(&link, intern!(py, "dst"))?;
        self.react(py, self.driver.get().on_link(py, up, &locator)?)
    }
}

impl Report {
    fn react(&self, py: Python<'_>, (items, polls): Reaction) -> PyResult<()> {
        if let Some(deliver) = &self.deliver {
            for item in items {
                deliver.call1(py, (item,))?;
            }
        }
        match &self.wake {
            Some(wake) if polls => wake.call1(py, (py.None(),)).map(drop),
            _ => Ok(()),
        }
    }
}

fn text(object: &Bound<'_, PyAny>, name: &Bound<'_, pyo3::types::PyString>) -> PyResult<String> {
    Ok(object.getattr(name)?.str()?.to_string())
}

/// Returns whether a `SampleKind` is `DELETE`.
pub fn is_delete(kind: &Bound<'_, PyAny>) -> PyResult<bool> {
    kind.eq(kind.get_type().getattr(intern!(kind.py(), "DELETE"))?)
}

/// Returns the number of the priority of a sample.
pub fn priority_of(sample: &Bound<'_, PyAny>) -> PyResult<u8> {
    let priority = sample.getattr(intern!(sample.py(), "priority"))?;
    priority
        .call_method0(intern!(sample.py(), "__int__"))?
        .extract()
}

/// Returns the bytes of a `ZBytes`.
pub fn bytes_of<'py>(zbytes: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    zbytes.call_method0(intern!(zbytes.py(), "to_bytes"))
}
