//! Converts the connections of a robot's router between C and the library.
use std::{ffi::c_char, mem::MaybeUninit};

use rect::Name;
use serde_json::Value;

use crate::{
    argument::{require, text, text_or_none},
    boundary::{call, require_out, write_out, ErrorOut},
    failure::{Code, Failure},
    handle::{self, Object},
    program::Program,
    robot::RobotHandle,
    text::{string_into_c, StringView, Text},
};

/// The state of a connection.
#[repr(C)]
#[derive(Clone, Copy)]
pub enum ConnectionState {
    /// There is a link.
    Connected = 0,
    /// The router dials the peer, or waits for it to dial.
    Connecting = 1,
    /// An advertisement of the robot was received; there is no link to it.
    Discovered = 2,
}

/// A connection of a robot's router (docs/reference/registry.md). An unknown value is an empty text, -1 for an integer, or NAN.
#[repr(C)]
pub struct Connection {
    /// The name of a named connection; otherwise empty.
    pub name: Text,
    /// The method of the link: `any`, `ble`, `tcp`, `udp` and so on.
    pub method: Text,
    /// The address of the other end.
    pub address: Text,
    /// The Zenoh id of the peer.
    pub peer_id: Text,
    /// The name of the peer's robot.
    pub peer: Text,
    /// The state.
    pub state: ConnectionState,
    /// Time since the link was established, in seconds.
    pub up_s: f64,
    /// Round-trip time of a small message, in milliseconds.
    pub round_trip_ms: f64,
    /// Received signal strength, in dBm.
    pub rssi_dbm: f64,
    /// 1 if the link is encrypted, 0 if it is not, -1 if that is not known.
    pub encrypted: i32,
    /// For the method `any`, the method of the path that carries the bulk: `ble` or `tcp`.
    pub path: Text,
    /// For the method `any`, how often that path has changed.
    pub switches: i64,
    /// Why it has changed last: `ended`, `silent` or `faster`. Empty if it has not.
    pub last_switch_reason: Text,
    /// How long data had waited when another path took it over, in milliseconds.
    pub last_switch_gap_ms: f64,
    /// Time since that change, in seconds.
    pub last_switch_ago_s: f64,
    /// Number of bytes that wait to be sent, for the methods `any` and `ble`.
    pub waiting_bytes: i64,
    /// Time until the peer has acknowledged an urgent message, in milliseconds, for these methods.
    pub urgent_delay_ms: f64,
    /// Number of batches that were not sent because Zenoh dropped their message, for these methods.
    pub dropped_batches: i64,
    /// Number of bytes sent.
    pub sent_bytes: i64,
    /// Number of bytes received.
    pub received_bytes: i64,
    /// How many times a link was established.
    pub linked: i64,
    /// How many attempts to establish a link failed.
    pub failed: i64,
    /// The last error.
    pub last_error: Text,
    /// Time since the last error, in seconds.
    pub last_error_ago_s: f64,
}

/// A list of connections. Release it with `rect_drop(&connections.id, ..)`.
#[repr(C)]
pub struct Connections {
    /// The handle.
    pub id: u64,
    /// The first connection.
    pub items: *const Connection,
    /// Number of connections.
    pub len: usize,
}

/// A named connection to add to a router. `name`, `method` and `address` are required; other fields that are 0 or NULL are
/// omitted.
#[repr(C)]
pub struct NamedConnection {
    /// The name of the connection.
    pub name: *const c_char,
    /// The method: `any`, `ble`, `tcp`, `udp` or another protocol of Zenoh.
    pub method: *const c_char,
    /// For `any` and `ble`, the name or Bluetooth address of a robot; for other methods, a host.
    pub address: *const c_char,
    /// The port, for methods that have ports.
    pub port: u16,
    /// The L2CAP PSM, for `ble`. If 0, the advertised PSM is used.
    pub psm: u16,
    /// Options of the locator as a JSON object, e.g. `{"mtu": 512}`.
    pub options: *const c_char,
}

struct OwnedConnections {
    _connections: Vec<rect::Connection>,
    _views: Vec<Connection>,
}

// SAFETY: the views point into the connections stored next to them, which never change.
unsafe impl Send for OwnedConnections {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedConnections {}

impl Object for OwnedConnections {
    const KIND: &'static str = "list of connections";
}

fn number_or_unknown(number: Option<u64>) -> i64 {
    number.map_or(-1, |number| i64::try_from(number).unwrap_or(i64::MAX))
}

fn view(connection: &rect::Connection) -> Connection {
    let peer = connection.peer.as_ref();
    let last_error = connection.last_error.as_ref();
    let switch = connection.last_switch.as_ref();
    let mut paths = connection.paths.iter().flatten();
    let primary = paths.find(|path| path.is_primary);
    Connection {
        name: Text::of_some(connection.name.as_deref()),
        method: Text::of(&connection.method),
        address: Text::of(&connection.address),
        peer_id: Text::of_some(peer.map(|peer| peer.id.as_str())),
        peer: Text::of_some(peer.and_then(|peer| peer.robot.as_deref())),
        state: match connection.state {
            rect::ConnectionState::Connected => ConnectionState::Connected,
            rect::ConnectionState::Connecting => ConnectionState::Connecting,
            rect::ConnectionState::Discovered => ConnectionState::Discovered,
        },
        up_s: connection.up_s.unwrap_or(f64::NAN),
        round_trip_ms: connection.round_trip_ms.unwrap_or(f64::NAN),
        rssi_dbm: connection.rssi_dbm.map_or(f64::NAN, f64::from),
        encrypted: connection.encrypted.map_or(-1, i32::from),
        path: Text::of_some(primary.map(|path| path.method.as_str())),
        switches: number_or_unknown(connection.switches),
        last_switch_reason: Text::of_some(switch.map(|switch| switch.reason.as_str())),
        last_switch_gap_ms: switch.map_or(f64::NAN, |switch| switch.gap_ms),
        last_switch_ago_s: switch.map_or(f64::NAN, |switch| switch.ago_s),
        waiting_bytes: number_or_unknown(connection.waiting_bytes()),
        urgent_delay_ms: connection.urgent_delay_ms().unwrap_or(f64::NAN),
        dropped_batches: number_or_unknown(connection.dropped_batches()),
        sent_bytes: number_or_unknown(connection.sent.map(|sent| sent.bytes)),
        received_bytes: number_or_unknown(connection.received.map(|received| received.bytes)),
        linked: number_or_unknown(connection.linked),
        failed: number_or_unknown(connection.failed),
        last_error: Text::of_some(last_error.map(|last_error| last_error.what.as_str())),
        last_error_ago_s: last_error.map_or(f64::NAN, |last_error| last_error.ago_s),
    }
}

fn into_c(connections: Vec<rect::Connection>) -> Connections {
    let views: Vec<Connection> = connections.iter().map(view).collect();
    let (items, len) = (views.as_ptr(), views.len());
    let id = handle::insert(OwnedConnections {
        _connections: connections,
        _views: views,
    });
    Connections { id, items, len }
}

/// Returns the robot whose router a call refers to: `target`, or the program's own robot if it is NULL.
pub fn target_robot(program: &Program, target: Option<&str>) -> Result<Name, Failure> {
    match target {
        None => Ok(program.robot.name().clone()),
        Some(name) => Ok(Name::new(name)?),
    }
}

/// # Safety
/// The pointers follow the rules of rect.h.
unsafe fn read(given: &NamedConnection) -> Result<rect::NamedConnection, Failure> {
    // SAFETY: guaranteed by this function's caller.
    let (name, method, address, options) = unsafe {
        (
            text("connection.name", given.name)?,
            text("connection.method", given.method)?,
            text("connection.address", given.address)?,
            text_or_none("connection.options", given.options)?,
        )
    };
    let mut connection = rect::NamedConnection::new(name, method, address);
    if given.port != 0 {
        connection = connection.port(given.port);
    }
    if given.psm != 0 {
        connection = connection.psm(given.psm);
    }
    let options: serde_json::Map<String, Value> = serde_json::from_str(options.unwrap_or("{}"))
        .map_err(|error| {
            Failure::argument(
                "connection.options",
                format!("is not a JSON object: {error}"),
            )
        })?;
    for (key, value) in options {
        connection = connection.option(key, value);
    }
    Ok(connection)
}

/// Queries the connections of a router and writes them to `connections`.
///
/// `target` is the robot whose router is queried; NULL means this robot. `filter` selects connections, e.g. `method=ble` or
/// `peer=wombat-2;state=connected` (docs/reference/registry.md); NULL means all.
///
/// Returns `RECT_CODE_NO_SERVICE` if the router does not answer. May be called on any thread; blocks until the reply
/// arrives.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_connections(
    robot: RobotHandle,
    target: *const c_char,
    filter: *const c_char,
    connections: Option<&mut MaybeUninit<Connections>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("connections", &connections)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (target, filter) = unsafe {
            (
                text_or_none("target", target)?,
                text_or_none("filter", filter)?,
            )
        };
        let program = robot.resolve()?;
        let target = target_robot(&program, target)?;
        let found = program.wait(
            program
                .robot
                .connections_of(target, filter.unwrap_or_default()),
        )?;
        write_out("connections", connections, into_c(found))
    })
}

/// Sends any question to the registry of a router, e.g. `connections/count` or `status` (docs/reference/registry.md), and writes the
/// answer, which is JSON, to `answer`. `target` and `filter` are the same as for `rect_robot_connections`.
///
/// Returns `RECT_CODE_NO_SERVICE` if the router does not answer. May be called on any thread; blocks until the reply
/// arrives.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_query_registry(
    robot: RobotHandle,
    target: *const c_char,
    question: *const c_char,
    filter: *const c_char,
    answer: Option<&mut MaybeUninit<StringView>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("answer", &answer)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (target, question, filter) = unsafe {
            (
                text_or_none("target", target)?,
                text("question", question)?,
                text_or_none("filter", filter)?,
            )
        };
        let program = robot.resolve()?;
        let target = target_robot(&program, target)?;
        let answer_future =
            program
                .robot
                .query_registry::<Value>(target, question, filter.unwrap_or_default());
        write_out(
            "answer",
            answer,
            string_into_c(program.wait(answer_future)?.to_string()),
        )
    })
}

/// Adds a named connection to a router, or replaces the one with the same name. The router dials it from now on, also after
/// a restart.
///
/// `target` is the robot whose router is changed; NULL means this robot. The access control of another robot's router must
/// permit the change.
///
/// Returns `RECT_CODE_SERVICE` if the router rejects the connection. May be called on any thread; blocks until the reply
/// arrives.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_add_connection(
    robot: RobotHandle,
    target: *const c_char,
    connection: Option<&NamedConnection>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let (target, connection) = unsafe {
            (
                text_or_none("target", target)?,
                read(require("connection", connection)?)?,
            )
        };
        let program = robot.resolve()?;
        let target = target_robot(&program, target)?;
        program.wait(program.robot.add_connection_of(target, &connection))
    })
}

/// Removes a named connection from a router and closes its link. `target` is the same as for `rect_robot_add_connection`.
///
/// Returns `RECT_CODE_SERVICE` if there is no connection with this name. May be called on any thread; blocks until the reply
/// arrives.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_remove_connection(
    robot: RobotHandle,
    target: *const c_char,
    name: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let (target, name) = unsafe { (text_or_none("target", target)?, text("name", name)?) };
        let program = robot.resolve()?;
        let target = target_robot(&program, target)?;
        program.wait(program.robot.remove_connection_of(target, name))
    })
}
