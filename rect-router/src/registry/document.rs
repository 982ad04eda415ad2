//! Owns what the registry says beside connections themselves, which are the library's: peers, counts, a robot at a glance,
//! as JSON that any Zenoh tool shows.
use std::collections::BTreeMap;

use rect::core::connection::{Connection, ConnectionState as State, PeerId};
use serde::Serialize;

use crate::config::AutoConnect;

/// Somebody, with the connections there are to it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Peer {
    /// Who.
    #[serde(flatten)]
    pub peer: PeerId,
    /// All that are asked for.
    pub connections: Vec<Connection>,
}

/// A robot at a glance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Status {
    /// Zenoh's identifier of its router.
    pub id: String,
    /// Of RECT, and of Zenoh.
    pub version: &'static str,
    /// For how long it has been running, in seconds.
    pub up_s: f64,
    /// Whom it connects to by itself.
    pub auto_connect: AutoConnect,
    /// With `fleet`, to how many beside those listed.
    pub auto_links: usize,
    /// Identifiers of other routers of the fleet that have this robot's name; none is as it should be.
    pub same_name: Vec<String>,
    /// How many connections it has.
    pub connections: Counts,
}

/// What time it is there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Clock {
    /// Seconds since 1970.
    pub unix_s: f64,
}

/// How many there are.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Of all methods.
    #[serde(flatten)]
    pub all: Count,
    /// Of each; those a robot commonly has are always there.
    pub methods: BTreeMap<String, Count>,
}

/// Of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// Wanted or there.
    pub total: usize,
    /// There.
    pub connected: usize,
    /// Heard, and neither.
    pub discovered: usize,
}

impl Counts {
    /// Of these.
    pub fn of(connections: &[Connection]) -> Self {
        let common = ["ble", "tcp", "udp"].map(|method| (method.to_owned(), Count::default()));
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

/// Each peer once, with its connections.
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
