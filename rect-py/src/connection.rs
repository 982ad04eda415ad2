//! Owns what is news about who can be reached.
use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use rect::core::{
    connection::{self, Connection, Event},
    name::Name,
    named_connection::NamedConnection,
};
use serde_json::Value;

/// What happened, to which robot, over which method, to which address.
type Told = (&'static str, Option<String>, Option<String>, Option<String>);

/// A connection as a router takes it; `options` is JSON.
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

/// The links of a router, as it tells of them.
#[pyclass(frozen, module = "rect._rect")]
#[derive(Default)]
pub struct Links(Mutex<connection::Links>);

/// The robots there are.
#[pyclass(frozen, module = "rect._rect")]
#[derive(Default)]
pub struct Presence(Mutex<connection::Presence>);

#[pymethods]
impl Links {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    /// All connections as they are now, as the registry's JSON; what has changed. What is no such JSON changes nothing.
    fn on_connections(&self, json: &[u8]) -> Vec<Told> {
        let Ok(all) = serde_json::from_slice::<Vec<Connection>>(json) else {
            return Vec::new();
        };
        let news = lock(&self.0).on_connections(&all);
        news.into_iter().map(told).collect()
    }
}

impl Links {
    /// By what a robot is linked with this one, where it is one way.
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

    /// A router or program of a robot has come.
    fn on_up(&self, robot: &str, id: &str) -> Option<Told> {
        let robot = Name::new(robot).ok()?;
        lock(&self.0).on_up(&robot, id).map(told)
    }

    /// It is gone.
    fn on_down(&self, robot: &str, id: &str) -> Option<Told> {
        let robot = Name::new(robot).ok()?;
        lock(&self.0).on_down(&robot, id).map(told)
    }
}

fn lock<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

fn told(event: Event) -> Told {
    let link = |what, link: connection::Link| {
        let robot = link.robot.map(|robot| robot.to_string());
        (what, robot, Some(link.method), Some(link.address))
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
