//! Exposes the decoder of received payloads, and the fetching of dictionaries.
use std::{sync::Mutex, time::Instant};

use pyo3::{prelude::*, pybacked::PyBackedBytes, IntoPyObjectExt};
use rect_core::{codec::CodecError, session::decoder};

use crate::{
    clock::Clock,
    codec::{parts, payload, Dictionary, Parts},
    detached::detached,
    driver::{lock, Driver, ToPython},
    errors::OrRaise,
    key_space::{name, KeySpace},
};

/// Decodes the payloads that one program receives, and keeps the dictionaries for that.
#[pyclass(frozen, module = "rect._rect")]
pub struct Decoder(Mutex<decoder::Decoder>);

/// The outcome of fetching a dictionary.
#[pyclass(frozen, module = "rect._rect")]
pub struct Fetched(Mutex<Option<decoder::Fetched>>);

#[pymethods]
impl Decoder {
    #[new]
    fn new(key_space: &KeySpace) -> Self {
        Self(Mutex::new(decoder::Decoder::new(key_space.0.clone())))
    }

    /// Decodes a payload of a robot. Returns `None` if it is not encoded by a codec. Raises `CodecError`.
    fn decode<'py>(
        &self,
        py: Python<'py>,
        sender: &str,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> PyResult<Option<Parts<'py>>> {
        let sender = name(sender)?;
        let payload = payload(bytes, encoding);
        let decoded = detached(py, || lock(&self.0).decode(&sender, &payload)).or_raise()?;
        Ok(decoded.map(|decoded| parts(py, &decoded)))
    }

    /// Returns the driver that fetches a missing dictionary. `None` if it was not available a short time ago.
    fn fetch(&self, sender: &str, id: u32) -> PyResult<Option<Driver>> {
        let clock = Clock::new();
        let missing = CodecError::Dictionary { id };
        let fetch = lock(&self.0).fetch(clock.now(), &name(sender)?, &missing);
        Ok(fetch.map(|fetch| Driver::new(fetch, &clock)))
    }

    /// Handles the outcome of a fetch. Returns why the dictionary is not available, or `None` if it is.
    fn on_fetched(&self, fetched: &Fetched) -> Option<String> {
        let fetched = lock(&fetched.0).take()?;
        let text = fetched.to_string();
        let is_available = lock(&self.0).on_fetched(Instant::now(), fetched);
        (!is_available).then_some(text)
    }

    /// Makes a dictionary available to receivers. Returns the key of the queryable to declare, or `None` if it is served
    /// already. Raises `DictionaryError`.
    fn serve(&self, dictionary: &Dictionary) -> PyResult<Option<String>> {
        lock(&self.0).serve(&dictionary.0).or_raise()
    }

    /// Withdraws a dictionary whose queryable could not be declared.
    fn on_not_served(&self, id: u32) {
        lock(&self.0).on_not_served(id);
    }
}

#[pymethods]
impl Fetched {
    fn __repr__(&self) -> String {
        match &*lock(&self.0) {
            Some(decoder::Fetched {
                dictionary: Some(dictionary),
                ..
            }) => format!("dictionary {}", dictionary.id()),
            Some(fetched) => fetched.to_string(),
            None => "handled".to_owned(),
        }
    }
}

impl ToPython for decoder::Fetched {
    fn to_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        Fetched(Mutex::new(Some(self))).into_py_any(py)
    }
}
