//! Owns what goes with requests, and with the errors that answer them.
use bytes::Bytes;
use pyo3::{prelude::*, types::PyBytes};
use rect::core::{
    encoding::Encoding,
    payload::Payload,
    request::{error_from_payload, error_to_payload, Asking},
};

use crate::place::name;

/// What goes with a request: who asks, and for how long it waits.
#[pyfunction]
pub fn write_asking<'py>(
    py: Python<'py>,
    robot: &str,
    timeout_ms: u32,
) -> PyResult<Bound<'py, PyBytes>> {
    let from = name(robot)?;
    Ok(PyBytes::new(py, &Asking { from, timeout_ms }.encode()))
}

/// Who asks, and for how long it waits; `None`: a stock program asks.
#[pyfunction]
pub fn read_asking(bytes: &[u8]) -> Option<(String, u32)> {
    let asking = Asking::decode(bytes)?;
    Some((asking.from.to_string(), asking.timeout_ms))
}

/// The encoding of an error of that robot's.
#[pyfunction]
pub fn error_encoding(robot: &str, encoding: String) -> PyResult<String> {
    let error = Payload::new(Bytes::new(), Encoding::new(encoding));
    Ok(error_to_payload(&name(robot)?, error).encoding.to_string())
}

/// Who answers so (`None`: a stock program), and what the error is.
#[pyfunction]
pub fn error_from(encoding: String) -> (Option<String>, String) {
    let answer = Payload::new(Bytes::new(), Encoding::new(encoding));
    let (from, error) = error_from_payload(answer);
    (
        from.map(|from| from.to_string()),
        error.encoding.to_string(),
    )
}
