//! Reports robots and links that appear and disappear, and encodes named connections.
use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use rect::core::{
    connection::{self, Connection, Event},
    name::Name,
    named_connection::NamedConnection,
};
use serde_json::Value;

/// The kind of the event, the robot, the method of the link, and the address of the peer.
type EventFields = (&'static str, Option<String>, Option<String>, Option<String>);

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

/// The robots that are reachable.
#[pyclass(frozen, module = "rect._rect")]
#[derive(Default)]
pub struct Presence(Mutex<connection::Presence>);

#[pymethods]
impl Links {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    /// Handles a report of all current connections, in the JSON of the registry. Returns the changes since the previous
    /// report. Invalid JSON changes nothing.
    fn on_connections(&self, json: &[u8]) -> Vec<EventFields> {
        let Ok(all) = serde_json::from_slice::<Vec<Connection>>(json) else {
            return Vec::new();
        };
        let events = lock(&self.0).on_connections(&all);
        events.into_iter().map(event_fields).collect()
    }
}

impl Links {
    /// Returns the method of the links to a robot. `None` if there is no link, or if the links have several methods.
    pub fn method_of(&self, robot: &Name) -> Option<String> {
        lock(&self.0).method(robot).map(str::to_owned)
    }
}

#[pymethods]
impl Presence {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    /// Handles the appearance of a liveliness token, which stands for a router or program of the robot.
    fn on_up(&self, robot: &str, id: &str) -> Option<EventFields> {
        let robot = Name::new(robot).ok()?;
        lock(&self.0).on_up(&robot, id).map(event_fields)
    }

    /// Handles the disappearance of a liveliness token.
    fn on_down(&self, robot: &str, id: &str) -> Option<EventFields> {
        let robot = Name::new(robot).ok()?;
        lock(&self.0).on_down(&robot, id).map(event_fields)
    }
}

fn lock<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

fn event_fields(event: Event) -> EventFields {
    let link = |kind, link: connection::Link| {
        let robot = link.robot.map(|robot| robot.to_string());
        (kind, robot, Some(link.method), Some(link.address))
    };
    match event {
        Event::PeerUp { robot } => ("peer_up", Some(robot.to_string()), None, None),
        Event::PeerDown { robot } => ("peer_down", Some(robot.to_string()), None, None),
        Event::LinkUp(up) => link("link_up", up),
        Event::LinkDown(down) => link("link_down", down),
        Event::RouterUp => ("router_up", None, None, None),
        Event::RouterDown => ("router_down", None, None, None),
    }
}
