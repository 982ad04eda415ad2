//! Wraps the drivers of transfers with the library's storage.
mod pull;
mod push;
mod reception;

pub use pull::TransferPull;
pub use push::TransferPush;
pub use reception::{OfferedTransfer, TransferReception};

use std::path::Path;

use pyo3::prelude::*;

use crate::errors::raised;

/// Makes a `FileError`.
fn file_error(py: Python<'_>, path: &Path, error: &std::io::Error) -> PyErr {
    let text = format!("{}: {error}", path.display());
    raised(py, "FileError", (text, error.raw_os_error()))
}
