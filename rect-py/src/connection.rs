//! Keeps track of the links that a router reports, and encodes named connections.
use std::sync::Mutex;

use pyo3::prelude::*;
use rect_core::{
    name::Name,
    registry::{connection, named_connection::NamedConnection},
};
use serde_json::Value;

use crate::driver::{lock, ConnectionsReport};

/// Encodes a named connection as JSON, for the config service of a router. `options` is a JSON object with the options
/// of the locator.
#[pyfunction]
pub fn named_connection(
    name: String,
    method: String,
    address: String,
    port: Option<u16>,
    psm: Option<u16>,
    options: &[u8],
) -> String {
    let mut connection = NamedConnection::new(name, method, address);
    if let Some(port) = port {
        connection = connection.port(port);
    }
    if let Some(psm) = psm {
        connection = connection.psm(psm);
    }
    let options: serde_json::Map<String, Value> =
        serde_json::from_slice(options).unwrap_or_default();
    for (key, value) in options {
        connection = connection.option(key, value);
    }
    connection.to_json()
}

/// The links that a router reports.
#[pyclass(frozen, module = "rect._rect")]
#[derive(Default)]
pub struct Links(Mutex<connection::Links>);

#[pymethods]
impl Links {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    /// Handles a report of all current connections.
    fn __call__(&self, report: &ConnectionsReport) {
        lock(&self.0).on_connections(&report.0);
    }
}

impl Links {
    /// Returns the method of the links to a robot. `None` if there is no link, or if the links have several methods.
    pub fn method_of(&self, robot: &Name) -> Option<String> {
        lock(&self.0).method(robot).map(str::to_owned)
    }
}
