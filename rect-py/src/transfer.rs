//! Wraps the drivers of transfers with the library's storage.
mod offered;
mod pull;
mod push;
mod reception;

pub use offered::OfferedTransfer;
pub use pull::TransferPull;
pub use push::TransferPush;
pub use reception::TransferReception;

use std::path::Path;

use pyo3::prelude::*;

use crate::errors::raised;

/// Makes a `FileError`.
fn file_error(py: Python<'_>, path: &Path, error: &std::io::Error) -> PyErr {
    let text = format!("{}: {error}", path.display());
    raised(py, "FileError", (text, error.raw_os_error()))
}
