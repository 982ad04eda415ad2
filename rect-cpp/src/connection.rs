//! Owns the connections of a robot's router as C gets and gives them.
use std::{ffi::c_char, mem::MaybeUninit};

use rect::{ConnectionState, Name};
use serde_json::Value;

use crate::{
    argument::{text, text_or_none, there},
    boundary::{call, give, wanted, ErrorOut},
    failure::{Code, Failure},
    handle::{self, Object},
    program::Program,
    robot::Robot,
    text::{hold_string, StringView, Text},
};

/// How far a connection is.
#[repr(C)]
#[derive(Clone, Copy)]
pub enum Linked {
    /// There is a link.
    Connected = 0,
    /// It is dialled or waited for.
    Connecting = 1,
    /// The robot is in the air, and there is no link with it.
    Discovered = 2,
}

/// A connection of a robot's router (docs/registry.md). What is not known is an empty text, -1, or not a number (NAN).
#[repr(C)]
pub struct Connection {
    /// Its name, if it is a named one.
    pub name: Text,
    /// `ble`, `tcp`, `udp`, ...
    pub method: Text,
    /// The other end.
    pub address: Text,
    /// The Zenoh id of who is there.
    pub peer_id: Text,
    /// Which robot that is.
    pub peer: Text,
    /// How far it is.
    pub state: Linked,
    /// For how long, in s.
    pub up_s: f64,
    /// What a small message takes there and back, in ms.
    pub round_trip_ms: f64,
    /// How strong its signal is, in dBm.
    pub rssi_dbm: f64,
    /// Bytes sent.
    pub sent_bytes: i64,
    /// Bytes received.
    pub received_bytes: i64,
    /// How often it was linked.
    pub linked: i64,
    /// How often it could not be.
    pub failed: i64,
    /// What went wrong last.
    pub last_error: Text,
    /// How long ago that was, in s.
    pub last_error_ago_s: f64,
}

/// Connections. `rect_drop(&connections.id, ..)` when they are not needed any more.
#[repr(C)]
pub struct Connections {
    /// Their handle.
    pub id: u64,
    /// The first.
    pub items: *const Connection,
    /// How many.
    pub len: usize,
}

/// A connection that a router is to have. What is 0 or NULL is left out.
#[repr(C)]
pub struct NamedConnection {
    /// Its name.
    pub name: *const c_char,
    /// `ble`, `tcp`, `udp`, or any other of Zenoh's protocols.
    pub method: *const c_char,
    /// For `ble` a robot's name or its Bluetooth address, else a host.
    pub address: *const c_char,
    /// For methods with one.
    pub port: u16,
    /// For `ble`: the L2CAP channel's number; left out, the advertised one.
    pub psm: u16,
    /// Options of the method's locator, a JSON object: `{"mtu": 512}`.
    pub options: *const c_char,
}

struct Held {
    _connections: Vec<rect::Connection>,
    _views: Vec<Connection>,
}

// SAFETY: the views point into the connections beside them, which never change.
unsafe impl Send for Held {}
// SAFETY: as above.
unsafe impl Sync for Held {}

impl Object for Held {
    const KIND: &'static str = "list of connections";
}

fn number(given: Option<u64>) -> i64 {
    given.map_or(-1, |given| i64::try_from(given).unwrap_or(i64::MAX))
}

fn view(one: &rect::Connection) -> Connection {
    let peer = one.peer.as_ref();
    let trouble = one.last_error.as_ref();
    Connection {
        name: Text::of_some(one.name.as_deref()),
        method: Text::of(&one.method),
        address: Text::of(&one.address),
        peer_id: Text::of_some(peer.map(|peer| peer.id.as_str())),
        peer: Text::of_some(peer.and_then(|peer| peer.robot.as_deref())),
        state: match one.state {
            ConnectionState::Connected => Linked::Connected,
            ConnectionState::Connecting => Linked::Connecting,
            ConnectionState::Discovered => Linked::Discovered,
        },
        up_s: one.up_s.unwrap_or(f64::NAN),
        round_trip_ms: one.round_trip_ms.unwrap_or(f64::NAN),
        rssi_dbm: one.rssi_dbm.map_or(f64::NAN, f64::from),
        sent_bytes: number(one.sent.map(|sent| sent.bytes)),
        received_bytes: number(one.received.map(|received| received.bytes)),
        linked: number(one.linked),
        failed: number(one.failed),
        last_error: Text::of_some(trouble.map(|trouble| trouble.what.as_str())),
        last_error_ago_s: trouble.map_or(f64::NAN, |trouble| trouble.ago_s),
    }
}

fn hold(connections: Vec<rect::Connection>) -> Connections {
    let views: Vec<Connection> = connections.iter().map(view).collect();
    let (items, len) = (views.as_ptr(), views.len());
    let id = handle::insert(Held {
        _connections: connections,
        _views: views,
    });
    Connections { id, items, len }
}

/// Of whom: that robot, or this one.
fn whose(program: &Program, of: Option<&str>) -> Result<Name, Failure> {
    match of {
        None => Ok(program.robot.name().clone()),
        Some(of) => Ok(Name::new(of)?),
    }
}

/// # Safety
/// It is as rect.h asks.
unsafe fn read(given: &NamedConnection) -> Result<rect::NamedConnection, Failure> {
    // SAFETY: as this function asks.
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
            Failure::argument("connection.options", format!("is no JSON object: {error}"))
        })?;
    for (key, value) in options {
        connection = connection.option(key, value);
    }
    Ok(connection)
}

/// The connections of a router. `of`: of which robot; NULL: this one. `which`: NULL for all, or as `method=ble`,
/// `peer=wombat-2;state=connected` (docs/registry.md).
///
/// Thread: any. Waits for the router's answer.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_connections(
    robot: Robot,
    of: *const c_char,
    which: *const c_char,
    connections: Option<&mut MaybeUninit<Connections>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("connections", &connections)?;
        // SAFETY: as rect.h asks.
        let (of, which) = unsafe { (text_or_none("of", of)?, text_or_none("which", which)?) };
        let program = robot.live()?;
        let of = whose(&program, of)?;
        let found = program.wait(program.robot.connections_of(of, which.unwrap_or_default()))?;
        give("connections", connections, hold(found))
    })
}

/// Any question of the registry, as `connections/count` or `status` (docs/registry.md); the answer is JSON. `of` and `which`
/// as `rect_robot_connections`.
///
/// Thread: any. Waits for the router's answer.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_ask_registry(
    robot: Robot,
    of: *const c_char,
    question: *const c_char,
    which: *const c_char,
    answer: Option<&mut MaybeUninit<StringView>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("answer", &answer)?;
        // SAFETY: as rect.h asks.
        let (of, question, which) = unsafe {
            (
                text_or_none("of", of)?,
                text("question", question)?,
                text_or_none("which", which)?,
            )
        };
        let program = robot.live()?;
        let of = whose(&program, of)?;
        let asked = program
            .robot
            .ask_registry::<Value>(of, question, which.unwrap_or_default());
        give(
            "answer",
            answer,
            hold_string(program.wait(asked)?.to_string()),
        )
    })
}

/// Gives a router a connection, instead of the one of that name if it has one; it is dialled from now on, and after a
/// restart. `of`: of which robot, whose access control has to allow that; NULL: this one.
///
/// Thread: any. Waits for the router's answer.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_add_connection(
    robot: Robot,
    of: *const c_char,
    connection: Option<&NamedConnection>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        let (of, connection) = unsafe {
            (
                text_or_none("of", of)?,
                read(there("connection", connection)?)?,
            )
        };
        let program = robot.live()?;
        let of = whose(&program, of)?;
        program.wait(program.robot.add_connection_of(of, &connection))
    })
}

/// Takes a connection from a router; its link ends. `of` as `rect_robot_add_connection`.
///
/// Thread: any. Waits for the router's answer.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_remove_connection(
    robot: Robot,
    of: *const c_char,
    name: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        let (of, name) = unsafe { (text_or_none("of", of)?, text("name", name)?) };
        let program = robot.live()?;
        let of = whose(&program, of)?;
        program.wait(program.robot.remove_connection_of(of, name))
    })
}
