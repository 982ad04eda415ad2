//! Encodes and decodes the headers of requests, and the encodings of error replies.
use bytes::Bytes;
use pyo3::{prelude::*, types::PyBytes};
use rect::core::{
    encoding::Encoding,
    payload::Payload,
    request::{error_from_payload, error_to_payload, RequestHeader},
};

use crate::key_space::name;

/// Encodes the header of a request: the robot that sends it, and its timeout in milliseconds.
#[pyfunction]
pub fn write_request_header<'py>(
    py: Python<'py>,
    robot: &str,
    timeout_ms: u32,
) -> PyResult<Bound<'py, PyBytes>> {
    let sender = name(robot)?;
    let header = RequestHeader { sender, timeout_ms };
    Ok(PyBytes::new(py, &header.encode()))
}

/// Decodes the header of a request: its sender, and its timeout in milliseconds. Returns `None` if the bytes are not a
/// header of RECT.
#[pyfunction]
pub fn read_request_header(bytes: &[u8]) -> Option<(String, u32)> {
    let header = RequestHeader::decode(bytes)?;
    Some((header.sender.to_string(), header.timeout_ms))
}

/// Returns the encoding of an error reply of a robot. `encoding` is that of the error's payload.
#[pyfunction]
pub fn error_encoding(robot: &str, encoding: String) -> PyResult<String> {
    let error = Payload::new(Bytes::new(), Encoding::new(encoding));
    Ok(error_to_payload(&name(robot)?, error).encoding.to_string())
}

/// Splits the encoding of an error reply into the robot (`None` if it does not use RECT) and the encoding of the error.
#[pyfunction]
pub fn error_from(encoding: String) -> (Option<String>, String) {
    let reply = Payload::new(Bytes::new(), Encoding::new(encoding));
    let (robot, error) = error_from_payload(reply);
    (
        robot.map(|robot| robot.to_string()),
        error.encoding.to_string(),
    )
}
