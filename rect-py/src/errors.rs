//! Owns turning the core's errors into the classes of `rect.errors`.
use pyo3::{prelude::*, sync::PyOnceLock, types::PyModule};
use rect::core::{
    codec::CodecError, dictionary::DictionaryError, name::NameError, payload::PayloadError,
    topic::TopicError, transfer::OfferError, wording,
};

static ERRORS: PyOnceLock<Py<PyModule>> = PyOnceLock::new();

/// An error of the class of that name, made of these arguments.
pub fn raised<'py, A>(py: Python<'py>, class: &str, arguments: A) -> PyErr
where
    A: pyo3::call::PyCallArgs<'py>,
{
    let module = ERRORS.get_or_try_init(py, || Ok(PyModule::import(py, "rect.errors")?.unbind()));
    let made = module.and_then(|module| module.bind(py).getattr(class)?.call1(arguments));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// What the core says is wrong.
pub trait Raised {
    /// As Python's.
    fn raised(self) -> PyErr;
}

/// The value, or Python's form of the error.
pub trait OrRaise<T> {
    /// See the trait.
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: Raised> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(Raised::raised)
    }
}

impl Raised for NameError {
    fn raised(self) -> PyErr {
        Python::attach(|py| raised(py, "InvalidNameError", (self.to_string(),)))
    }
}

impl Raised for TopicError {
    fn raised(self) -> PyErr {
        match self {
            Self::Robot(name) => name.raised(),
            topic => Python::attach(|py| raised(py, "InvalidTopicError", (topic.to_string(),))),
        }
    }
}

impl Raised for CodecError {
    fn raised(self) -> PyErr {
        let (kind, dictionary) = match &self {
            Self::Unknown { .. } => ("unknown", None),
            Self::Option { .. } => ("option", None),
            Self::Kind { .. } => ("kind", None),
            Self::Damaged { .. } => ("damaged", None),
            Self::TooLarge { .. } => ("too large", None),
            Self::Dictionary { id } => ("dictionary", Some(*id)),
            Self::Failed { .. } => ("failed", None),
        };
        let text = self.to_string();
        Python::attach(|py| raised(py, "CodecError", (text, kind, dictionary)))
    }
}

impl Raised for PayloadError {
    fn raised(self) -> PyErr {
        let kind = match self {
            Self::Codec(codec) => return codec.raised(),
            Self::Write { .. } => "write",
            Self::Encoding(_) => "encoding",
            Self::Other { .. } => "other",
            Self::Read { .. } => "read",
        };
        Python::attach(|py| raised(py, "PayloadError", (self.to_string(), kind)))
    }
}

impl Raised for DictionaryError {
    fn raised(self) -> PyErr {
        Python::attach(|py| raised(py, "DictionaryError", (wording::with_causes(&self),)))
    }
}

impl Raised for OfferError {
    fn raised(self) -> PyErr {
        Python::attach(|py| raised(py, "TransferError", (self.to_string(),)))
    }
}

/// What Zenoh says, on one line, without places in its source.
#[pyfunction]
pub fn in_words(said: &str) -> String {
    wording::on_one_line(said)
}

/// Never lets go of an object: after a fork, ending it would wait for threads that the child does not have.
#[pyfunction]
pub fn forget(object: Py<PyAny>) {
    std::mem::forget(object);
}
