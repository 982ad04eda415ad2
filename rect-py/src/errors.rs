//! Converts the errors of the core to the exceptions of `rect.errors`.
use pyo3::{prelude::*, sync::PyOnceLock, types::PyModule};
use rect_core::{
    codec::{dictionary::DictionaryError, CodecError},
    message::{payload::PayloadError, throttled::WishError},
    name::{topic::TopicError, NameError},
    text::humanize,
    transfer::OfferError,
};

static ERRORS: PyOnceLock<Py<PyModule>> = PyOnceLock::new();

/// Creates an exception: an instance of the class `class` of `rect.errors`, called with `arguments`.
pub fn raised<'py, A>(py: Python<'py>, class: &str, arguments: A) -> PyErr
where
    A: pyo3::call::PyCallArgs<'py>,
{
    let module = ERRORS.get_or_try_init(py, || Ok(PyModule::import(py, "rect.errors")?.unbind()));
    let made = module.and_then(|module| module.bind(py).getattr(class)?.call1(arguments));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// An error of the core.
pub trait Raised {
    /// Converts the error to a Python exception.
    fn raised(self) -> PyErr;
}

/// Converts the error of a `Result` to a Python exception.
pub trait OrRaise<T> {
    /// Returns the value, or the error as a Python exception.
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
            Self::Mismatch { .. } | Self::Forgotten => "other",
            Self::Read { .. } => "read",
            Self::Type(_) => "mismatch",
        };
        Python::attach(|py| raised(py, "PayloadError", (self.to_string(), kind)))
    }
}

impl Raised for DictionaryError {
    fn raised(self) -> PyErr {
        Python::attach(|py| raised(py, "DictionaryError", (humanize::with_causes(&self),)))
    }
}

impl Raised for WishError {
    fn raised(self) -> PyErr {
        let reason = self.to_string();
        Python::attach(|py| raised(py, "OptionError", ("max_hz", self.0, reason)))
    }
}

impl Raised for OfferError {
    fn raised(self) -> PyErr {
        Python::attach(|py| raised(py, "TransferError", (self.to_string(),)))
    }
}

/// Formats an error text of Zenoh on one line, without the positions in Zenoh's source code.
#[pyfunction]
pub fn on_one_line(text: &str) -> String {
    humanize::on_one_line(text)
}

/// Leaks an object. After a fork, dropping it would wait for threads that the child process does not have.
#[pyfunction]
pub fn forget(object: Py<PyAny>) {
    std::mem::forget(object);
}
