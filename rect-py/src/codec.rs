//! Exposes codecs and dictionaries, which compress and decompress payloads.
use std::sync::Arc;

use bytes::Bytes;
use pyo3::{prelude::*, pybacked::PyBackedBytes, types::PyBytes};
use rect_core::{
    codec::{
        self,
        dictionary::{self, Dictionaries},
        dictionary_codec::DictionaryCodec,
        Limits,
    },
    message::{encoding::Encoding, payload::Payload},
};

use crate::{detached::detached, errors::OrRaise};

/// The bytes and the encoding of a payload, as Python objects.
pub type Parts<'py> = (Bound<'py, PyBytes>, String);

/// A codec, which compresses payloads. It is created from its name.
///
/// The names are `none`, `zstd[:<level 1 to 19>]`, `png`, `jpeg[:<quality 1 to 100>]`, `webp[:<quality 1 to 100>]` and
/// `quantised:<largest error>`. A codec that uses a dictionary is created from the dictionary; `Robot.share_dictionary`
/// returns it.
///
/// Raises `CodecError` if there is no such codec.
#[pyclass(frozen, module = "rect._rect")]
pub struct Codec(Arc<dyn codec::Codec>, Option<Py<Dictionary>>);

/// The description from which a codec is created.
#[derive(FromPyObject)]
enum Spec {
    #[pyo3(annotation = "str")]
    Name(String),
    #[pyo3(annotation = "Dictionary")]
    Dictionary(Py<Dictionary>),
}

/// A zstd dictionary: the common content of many small messages, stored at both ends instead of sent each time.
///
/// It is created from the bytes of a dictionary, or by `train` from sample messages. `bytes(dictionary)` returns its
/// bytes.
///
/// Raises `DictionaryError` if the bytes are not a dictionary.
#[pyclass(frozen, module = "rect._rect")]
pub struct Dictionary(pub Arc<dictionary::Dictionary>);

/// Makes a payload that shares the bytes of a Python object.
pub fn payload(bytes: PyBackedBytes, encoding: &str) -> Payload {
    let encoding = Encoding::new(encoding.to_owned());
    Payload::new(Bytes::from_owner(bytes), encoding)
}

/// Converts a payload to Python objects.
pub fn parts<'py>(py: Python<'py>, payload: &Payload) -> Parts<'py> {
    let bytes = PyBytes::new(py, &payload.bytes);
    (bytes, payload.encoding.to_string())
}

/// Returns the limits of a decoder. Those that are `None` have their defaults.
pub fn limits(max_bytes: Option<usize>, max_pixels: Option<usize>) -> Limits {
    let default = Limits::default();
    Limits {
        max_bytes: max_bytes.unwrap_or(default.max_bytes),
        max_pixels: max_pixels.unwrap_or(default.max_pixels),
    }
}

#[pymethods]
impl Codec {
    /// Creates the codec with a name such as `zstd:9`, or a zstd codec that uses a dictionary.
    #[new]
    fn new(spec: Spec) -> PyResult<Self> {
        Ok(match spec {
            Spec::Name(name) => Self(codec::parse(&name).or_raise()?, None),
            Spec::Dictionary(dictionary) => {
                let codec = DictionaryCodec::new(dictionary.get().0.clone());
                Self(Arc::new(codec), Some(dictionary))
            }
        })
    }

    /// Returns how `pickle` and `copy` make the same codec.
    fn __reduce__(this: &Bound<'_, Self>) -> PyResult<(Py<PyAny>, (Py<PyAny>,))> {
        let (py, codec) = (this.py(), this.get());
        let spec = match &codec.1 {
            Some(dictionary) => dictionary.clone_ref(py).into_any(),
            None => codec.name().into_pyobject(py)?.into_any().unbind(),
        };
        Ok((this.get_type().into_any().unbind(), (spec,)))
    }

    /// The full name, such as `zstd:9`.
    #[getter]
    fn name(&self) -> String {
        self.0.name()
    }

    /// Compresses a payload. Returns the bytes and the encoding. Raises `CodecError`.
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

/// Decodes a payload completely, even if several codecs have encoded it. Raises `CodecError`.
#[pyfunction]
#[pyo3(signature = (bytes, encoding, dictionaries, max_bytes=None))]
pub fn decode<'py>(
    py: Python<'py>,
    bytes: PyBackedBytes,
    encoding: &str,
    dictionaries: Vec<Bound<'py, Dictionary>>,
    max_bytes: Option<usize>,
) -> PyResult<Parts<'py>> {
    let mut store = Dictionaries::default();
    for dictionary in dictionaries {
        store.add(dictionary.get().0.clone()).or_raise()?;
    }
    let payload = payload(bytes, encoding);
    let limits = limits(max_bytes, None);
    let decoded = detached(py, || codec::decode(&payload, &limits, &store)).or_raise()?;
    Ok(parts(py, &decoded))
}

#[pymethods]
impl Dictionary {
    /// Loads a zstd dictionary.
    #[new]
    fn new(bytes: Vec<u8>) -> PyResult<Self> {
        let read = dictionary::Dictionary::new(bytes).or_raise()?;
        Ok(Self(Arc::new(read)))
    }

    /// Trains a dictionary of at most `size` bytes from sample messages. Raises `DictionaryError` if they are
    /// unsuitable.
    #[staticmethod]
    fn train(py: Python<'_>, samples: Vec<Vec<u8>>, size: usize) -> PyResult<Self> {
        let trained = detached(py, || dictionary::Dictionary::train(&samples, size));
        Ok(Self(Arc::new(trained.or_raise()?)))
    }

    /// The id that compressed payloads refer to.
    #[getter]
    fn id(&self) -> u32 {
        self.0.id()
    }

    /// Returns how `pickle` and `copy` make the same dictionary.
    fn __reduce__<'py>(this: &Bound<'py, Self>) -> (Bound<'py, PyAny>, (Bound<'py, PyBytes>,)) {
        let bytes = this.get().__bytes__(this.py());
        (this.get_type().into_any(), (bytes,))
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0.as_bytes() == other.0.as_bytes()
    }

    fn __hash__(&self) -> u64 {
        self.0.id().into()
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, self.0.as_bytes())
    }

    fn __repr__(&self) -> String {
        format!("{:?}", self.0)
    }
}
