//! Defines a named connection as a program sends it to a router (`config/connections.schema.json`). The router
//! validates it.
use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;

/// A named connection that a robot's router is asked to keep connected.
///
/// ```
/// use rect_core::registry::named_connection::NamedConnection;
/// let radio = NamedConnection::new("arm", "ble", "wombat-2");
/// let laptop = NamedConnection::new("base", "tcp", "192.168.125.2").port(7447);
/// assert_eq!(laptop.to_json(), r#"{"name":"base","method":"tcp","address":"192.168.125.2","port":7447}"#);
/// # let _ = radio;
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NamedConnection {
    name: String,
    method: String,
    address: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    port: Option<u16>,
    #[serde(skip_serializing_if = "Option::is_none")]
    psm: Option<u16>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    options: BTreeMap<String, Value>,
}

impl NamedConnection {
    /// Creates a named connection. `method` is `ble`, `tcp`, `udp` or any other protocol of Zenoh. `address` is a
    /// robot's name or Bluetooth address for `ble`, and a host for the other methods.
    pub fn new(
        name: impl Into<String>,
        method: impl Into<String>,
        address: impl Into<String>,
    ) -> Self {
        Self {
            name: name.into(),
            method: method.into(),
            address: address.into(),
            port: None,
            psm: None,
            options: BTreeMap::new(),
        }
    }

    /// Sets the port, for methods that have one.
    #[must_use]
    pub fn port(self, port: u16) -> Self {
        Self {
            port: Some(port),
            ..self
        }
    }

    /// Sets the number of the L2CAP channel, for `ble`. Default: the advertised number.
    #[must_use]
    pub fn psm(self, psm: u16) -> Self {
        Self {
            psm: Some(psm),
            ..self
        }
    }

    /// Adds an option of the method's locator, such as `mtu` for `ble`. The value is text, a number, or a boolean.
    #[must_use]
    pub fn option(mut self, key: impl Into<String>, value: impl Into<Value>) -> Self {
        self.options.insert(key.into(), value.into());
        self
    }

    /// Returns the JSON document that the router accepts.
    pub fn to_json(&self) -> String {
        // This cannot fail: text, numbers and text keys are always valid JSON.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// The key of the config service, below [`own`](crate::name::key::KeySpace::own), which reads and changes a router's
/// connections. Changes are accepted from programs of the same robot, and from the clients that the router's access
/// control lists.
pub const CONFIG: &str = "@config/connections";
/// The parameter of a request that adds the connection in the payload.
pub const ADD: &str = "add";
/// The parameter of a request that removes the connection whose name is the payload.
pub const REMOVE: &str = "remove";
