//! Defines the JSON documents of the registry: peers, counts, status and clock. The document of a connection is defined by
//! the library.
use std::collections::BTreeMap;

use rect_connections::AutoConnect;
use rect_core::registry::connection::{Connection, ConnectionState as State, PeerId};
use serde::Serialize;

/// A peer with the connections to it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Peer {
    /// Identifier of the peer's router, and name of its robot.
    #[serde(flatten)]
    pub peer: PeerId,
    /// Connections to the peer that match the query.
    pub connections: Vec<Connection>,
}

/// The status of a robot.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Status {
    /// Zenoh identifier of its router.
    pub id: String,
    /// Versions of RECT and Zenoh.
    pub version: &'static str,
    /// Time for which the router has been running, in seconds.
    pub up_s: f64,
    /// Robots that it connects to automatically.
    pub auto_connect: AutoConnect,
    /// With `fleet`, the number of links to discovered robots in addition to the listed ones.
    pub auto_links: usize,
    /// Identifiers of other routers of the fleet with this robot's name; normally empty.
    pub same_name: Vec<String>,
    /// Whether the router may choose connection intervals on Linux; `None` before the first Bluetooth link.
    pub chooses_intervals: Option<bool>,
    /// Adapters of the Bluetooth listeners of its router; those named `sim...` are of the simulated air.
    pub adapters: Vec<String>,
    /// Number of declarations of its programs that had to wait, because a program made too many.
    pub delayed_declarations: u64,
    /// Number of its connections.
    pub connections: Counts,
    /// The alerts of its programs (docs/how-to/why.md); left out if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub alerts: Vec<serde_json::Value>,
}

/// The clock of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Clock {
    /// Seconds since 1970-01-01 UTC.
    pub unix_s: f64,
}

/// The number of connections, in total and by method.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Connections of all methods.
    #[serde(flatten)]
    pub all: Count,
    /// Connections by method; always contains `any`, `ble`, `tcp` and `udp`.
    pub methods: BTreeMap<String, Count>,
}

/// The number of connections by state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// Connections that are connected or being dialled.
    pub total: usize,
    /// Connections that are connected.
    pub connected: usize,
    /// Discovered robots without a connection; not part of the total.
    pub discovered: usize,
}

impl Counts {
    /// Counts connections by method and state.
    pub fn of(connections: &[Connection]) -> Self {
        let common =
            ["any", "ble", "tcp", "udp"].map(|method| (method.to_owned(), Count::default()));
        let mut counts = Self {
            all: Count::default(),
            methods: common.into(),
        };
        for connection in connections {
            let of_method = counts.methods.entry(connection.method.clone()).or_default();
            for count in [&mut counts.all, of_method] {
                match connection.state {
                    State::Discovered => {
                        count.discovered += 1;
                        continue;
                    }
                    State::Connected => count.connected += 1,
                    State::Connecting => {}
                }
                count.total += 1;
            }
        }
        counts
    }
}

/// Groups connections by peer. Connections without a peer are left out.
pub fn peers(connections: Vec<Connection>) -> Vec<Peer> {
    let mut peers: BTreeMap<String, Peer> = BTreeMap::new();
    for connection in connections {
        let Some(peer) = connection.peer.clone() else {
            continue;
        };
        let entry = peers.entry(peer.id.clone()).or_insert_with(|| Peer {
            peer,
            connections: Vec::new(),
        });
        entry.connections.push(connection);
    }
    peers.into_values().collect()
}
