//! Creates the drivers that a program uses without a handle.
use std::time::{Duration, SystemTime};

use pyo3::prelude::*;
use rect_core::{
    catalogue::Instance,
    clock::unix::ms_since_1970,
    name::Name,
    registry::{
        observer::{Observer, RouterObserver},
        RegistryQuery,
    },
    session::{
        names,
        peers::{self, DirectPresence, EstablishedWait, PeerWait, PeersQuery},
    },
    throttle::Throttle,
};

use super::Driver;
use crate::{
    clock::Clock,
    key_space::{name, KeySpace},
};

/// Creates the question which robots are reachable.
#[pyfunction]
pub fn peers_query(key_space: &KeySpace) -> Driver {
    Driver::new(PeersQuery::new(key_space.0.clone()), &Clock::new())
}

/// Returns in words which robots are reachable, for a program that uses `robot`, which is not.
#[pyfunction]
pub fn reachable_robots(robot: &str, reachable: Vec<String>) -> PyResult<String> {
    Ok(names::reachable_robots(&name(robot)?, &parsed(&reachable)?))
}

/// Returns the error that a robot, or all robots (`None`), did not reply to the request `topic`, which may have been carried out.
#[pyfunction]
pub fn interrupted(robot: Option<&str>, topic: &str) -> PyResult<String> {
    let robot = robot.map(name).transpose()?;
    Ok(names::interrupted(robot.as_ref(), topic))
}

/// Returns the error that no program serves `topic` at a robot, or in the fleet (`None`).
#[pyfunction]
pub fn no_service(robot: Option<&str>, topic: &str, reachable: Vec<String>) -> PyResult<String> {
    let robot = robot.map(name).transpose()?;
    Ok(names::no_service(
        robot.as_ref(),
        topic,
        &parsed(&reachable)?,
    ))
}

/// Returns the description of the problem that `robot`, to which a program sends, is not reachable.
#[pyfunction]
pub fn not_reachable(robot: &str, reachable: Vec<String>) -> PyResult<String> {
    Ok(names::not_reachable(&name(robot)?, &parsed(&reachable)?))
}

fn parsed(texts: &[String]) -> PyResult<Vec<Name>> {
    texts.iter().map(|text| name(text)).collect()
}

/// Returns the description of a connection with a robot that is not among the reachable ones.
#[pyfunction]
pub fn expected_connection(robot: &str, reachable: Vec<String>) -> PyResult<String> {
    Ok(peers::expected_connection(
        &name(robot)?,
        &parsed(&reachable)?,
    ))
}

/// Creates the wait until a robot is reachable.
#[pyfunction]
pub fn peer_wait(key_space: &KeySpace, robot: &str, timeout_s: f64) -> PyResult<Driver> {
    let clock = Clock::new();
    let now = clock.created_at();
    let wait = PeerWait::new(&key_space.0, &name(robot)?, now, seconds(timeout_s));
    Ok(Driver::new(wait, &clock))
}

/// Creates the wait until all reachable robots know what this program has declared.
#[pyfunction]
pub fn established_wait(key_space: &KeySpace, timeout_s: f64) -> Driver {
    let clock = Clock::new();
    let now = clock.created_at();
    let wait = EstablishedWait::new(&key_space.0, now, seconds(timeout_s));
    Driver::new(wait, &clock)
}

/// Creates the presence of a program without a router. `id` is the id of its Zenoh session. `unix_ms` is the time in
/// milliseconds since 1970; default: the time of the clock.
#[pyfunction]
#[pyo3(signature = (key_space, id, unix_ms=None))]
pub fn direct_presence(key_space: &KeySpace, id: &str, unix_ms: Option<u64>) -> Driver {
    let unix_ms = unix_ms.unwrap_or_else(|| ms_since_1970(SystemTime::now()));
    let clock = Clock::new();
    let presence = DirectPresence::new(&key_space.0, id, unix_ms, clock.created_at());
    Driver::new(presence, &clock)
}

/// Creates the throttle of a program without a router.
#[pyfunction]
pub fn throttle(key_space: &KeySpace) -> Driver {
    Driver::new(Throttle::new(key_space.0.clone()), &Clock::new())
}

/// Creates a question to the registry of a robot.
#[pyfunction]
pub fn registry_query(
    key_space: &KeySpace,
    robot: &str,
    question: &str,
    filter: &str,
) -> PyResult<Driver> {
    let query = RegistryQuery::new(key_space.0.clone(), name(robot)?, question, filter);
    Ok(Driver::new(query, &Clock::new()))
}

/// Creates a change of the named connections of a robot.
#[pyfunction]
pub fn registry_change(
    key_space: &KeySpace,
    robot: &str,
    action: &str,
    argument: String,
) -> PyResult<Driver> {
    let change = RegistryQuery::change(key_space.0.clone(), name(robot)?, action, argument);
    Ok(Driver::new(change, &Clock::new()))
}

/// Creates the observer of robots, programs, links and the router, for the program `instance`.
#[pyfunction]
pub fn observer(key_space: &KeySpace, instance: u32, is_direct: bool) -> Driver {
    let observer = Observer::new(key_space.0.clone(), Instance(instance), is_direct);
    Driver::new(observer, &Clock::new())
}

/// Creates the observer of the router's links, whose reports are for `Links`.
#[pyfunction]
pub fn router_observer(key_space: &KeySpace) -> Driver {
    Driver::new(RouterObserver::new(&key_space.0), &Clock::new())
}

/// Converts a duration; one that is too long counts as the longest.
pub fn seconds(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
}
