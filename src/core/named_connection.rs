//! Owns a named connection as a program gives it to a router (`config/connections.schema.json`); what is wrong with one, the
//! router says.
use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;

/// A connection that a robot's router is to have from now on.
///
/// ```
/// use rect::NamedConnection;
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
    /// `method`: `ble`, `tcp`, `udp`, or any other of Zenoh's protocols; `address`: for `ble` a robot's name or its Bluetooth
    /// address, else a host.
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

    /// For methods with one.
    #[must_use]
    pub fn port(self, port: u16) -> Self {
        Self {
            port: Some(port),
            ..self
        }
    }

    /// For `ble`: the L2CAP channel's number; left out, the advertised one.
    #[must_use]
    pub fn psm(self, psm: u16) -> Self {
        Self {
            psm: Some(psm),
            ..self
        }
    }

    /// An option of the method's locator, as `mtu` of `ble`: text, a number, true or false.
    #[must_use]
    pub fn option(mut self, key: impl Into<String>, value: impl Into<Value>) -> Self {
        self.options.insert(key.into(), value.into());
        self
    }

    /// What the router takes.
    pub fn to_json(&self) -> String {
        // Text and numbers, with text for keys: always JSON.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// Where a router's connections are read and changed, below [`own`](super::key::Place::own); to change them is for programs
/// of the robot itself, and for whom its access control lists.
pub const CONFIG: &str = "@config/connections";
/// The parameter of a question there that adds the connection of its payload.
pub const ADD: &str = "add";
/// The one that removes the connection of which the payload is the name.
pub const REMOVE: &str = "remove";
