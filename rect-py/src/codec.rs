//! Owns codecs and dictionaries: what makes payloads smaller, and undoes it.
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use pyo3::{prelude::*, pybacked::PyBackedBytes, types::PyBytes};
use rect::core::{
    codec::{self, dictionary::Packed, Limits},
    dictionary::{self, Dictionaries, RobotDictionaries},
    encoding::Encoding,
    payload::Payload,
};

use crate::{detached::detached, errors::OrRaise, place::name};

/// Bytes and what they are, as Python has them.
pub type Parts<'py> = (Bound<'py, PyBytes>, String);

/// A way to make payloads smaller.
#[pyclass(frozen, module = "rect._rect")]
pub struct Codec(Arc<dyn codec::Codec>);

/// What many messages have in common.
#[pyclass(frozen, module = "rect._rect")]
pub struct Dictionary(pub Arc<dictionary::Dictionary>);

/// The dictionaries of several robots, each for that robot's messages alone.
#[pyclass(frozen, module = "rect._rect")]
pub struct Known(Mutex<RobotDictionaries>);

/// Python's bytes as a payload, which shares them.
pub fn payload(bytes: PyBackedBytes, encoding: &str) -> Payload {
    let encoding = Encoding::new(encoding.to_owned());
    Payload::new(Bytes::from_owner(bytes), encoding)
}

/// A payload as Python's bytes.
pub fn parts<'py>(py: Python<'py>, payload: &Payload) -> Parts<'py> {
    let bytes = PyBytes::new(py, &payload.bytes);
    (bytes, payload.encoding.to_string())
}

/// A decoder's limits, or those that there are unless told otherwise.
pub fn limits(max_bytes: Option<usize>, max_pixels: Option<usize>) -> Limits {
    let default = Limits::default();
    Limits {
        max_bytes: max_bytes.unwrap_or(default.max_bytes),
        max_pixels: max_pixels.unwrap_or(default.max_pixels),
    }
}

#[pymethods]
impl Codec {
    /// The codec that a text such as `zstd:9` means.
    #[new]
    fn new(spec: &str) -> PyResult<Self> {
        codec::parse(spec).or_raise().map(Self)
    }

    /// zstd with a dictionary.
    #[staticmethod]
    fn packed(dictionary: &Dictionary) -> Self {
        Self(Arc::new(Packed::new(dictionary.0.clone())))
    }

    /// Its whole name.
    #[getter]
    fn name(&self) -> String {
        self.0.name()
    }

    /// Makes a payload smaller.
    fn encode<'py>(
        &self,
        py: Python<'py>,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> PyResult<Parts<'py>> {
        let payload = payload(bytes, encoding);
        let encoded = detached(py, || self.0.encode(&payload)).or_raise()?;
        Ok(parts(py, &encoded))
    }
}

/// Undoes the packings of a payload.
#[pyfunction]
#[pyo3(signature = (bytes, encoding, dictionaries, max_bytes=None))]
pub fn unpack<'py>(
    py: Python<'py>,
    bytes: PyBackedBytes,
    encoding: &str,
    dictionaries: Vec<Bound<'py, Dictionary>>,
    max_bytes: Option<usize>,
) -> PyResult<Parts<'py>> {
    let mut known = Dictionaries::default();
    for dictionary in dictionaries {
        known.add(dictionary.get().0.clone()).or_raise()?;
    }
    let payload = payload(bytes, encoding);
    let limits = limits(max_bytes, None);
    let decoded = detached(py, || codec::decode(&payload, &limits, &known)).or_raise()?;
    Ok(parts(py, &decoded))
}

#[pymethods]
impl Known {
    #[new]
    fn new() -> Self {
        Self(Mutex::default())
    }

    /// Adds one of that robot's.
    fn add(&self, robot: &str, dictionary: &Dictionary) -> PyResult<()> {
        let robot = name(robot)?;
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.add(&robot, dictionary.0.clone());
        Ok(())
    }

    /// Undoes the packings of a payload of that robot's.
    fn unpack<'py>(
        &self,
        py: Python<'py>,
        robot: &str,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> PyResult<Parts<'py>> {
        let robot = name(robot)?;
        let payload = payload(bytes, encoding);
        let decoded = py.detach(|| {
            let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let dictionaries = known.of(&robot).clone();
            drop(known);
            codec::decode(&payload, &Limits::default(), &dictionaries)
        });
        Ok(parts(py, &decoded.or_raise()?))
    }
}

#[pymethods]
impl Dictionary {
    /// Reads a zstd dictionary.
    #[new]
    fn new(bytes: Vec<u8>) -> PyResult<Self> {
        let read = dictionary::Dictionary::new(bytes).or_raise()?;
        Ok(Self(Arc::new(read)))
    }

    /// Makes one of samples.
    #[staticmethod]
    fn train(py: Python<'_>, samples: Vec<Vec<u8>>, size: usize) -> PyResult<Self> {
        let trained = detached(py, || dictionary::Dictionary::train(&samples, size));
        Ok(Self(Arc::new(trained.or_raise()?)))
    }

    /// What frames call it.
    #[getter]
    fn id(&self) -> u32 {
        self.0.id()
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, self.0.as_bytes())
    }

    fn __repr__(&self) -> String {
        format!("{:?}", self.0)
    }
}
