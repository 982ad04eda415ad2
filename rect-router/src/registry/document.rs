//! Owns what the registry says: connections and peers, as JSON that any Zenoh tool shows.
use std::collections::BTreeMap;

use serde::Serialize;

use crate::{config::AutoConnect, connections::Traffic};

/// Whether a connection carries messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// It does.
    Connected,
    /// It is wanted, and dialled until it does.
    Connecting,
    /// A robot of the fleet is heard, and not linked.
    Discovered,
}

impl State {
    /// By its name.
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "connected" => Some(Self::Connected),
            "connecting" => Some(Self::Connecting),
            "discovered" => Some(Self::Discovered),
            _ => None,
        }
    }
}

/// A connection that is wanted, there, or possible.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Connection {
    /// As the file names it; `null`: one that the other side made, or that has no name.
    pub name: Option<String>,
    /// `ble`, `tcp`, `udp`, ...
    pub method: String,
    /// Whom or where, without the method.
    pub address: String,
    /// Whether it carries messages.
    pub state: State,
    /// Who is at the other end, once that is known.
    pub peer: Option<PeerId>,
    /// For how long it has been there, in seconds.
    pub up_s: Option<f64>,
    /// What went out, where it is counted.
    pub sent: Option<Traffic>,
    /// What came, where it is counted.
    pub received: Option<Traffic>,
    /// There and back, in milliseconds, where it is measured.
    pub round_trip_ms: Option<f64>,
    /// How strong its signal is, in dBm, where it was heard within a minute.
    pub rssi_dbm: Option<i16>,
    /// How often it was made.
    pub linked: Option<u64>,
    /// Attempts that came to nothing since then.
    pub failed: Option<u64>,
    /// What went wrong last.
    pub last_error: Option<Trouble>,
}

impl Connection {
    /// One of which no more is known.
    pub fn of(method: &str, address: &str, state: State) -> Self {
        Self {
            name: None,
            method: method.to_owned(),
            address: address.to_owned(),
            state,
            peer: None,
            up_s: None,
            sent: None,
            received: None,
            round_trip_ms: None,
            rssi_dbm: None,
            linked: None,
            failed: None,
            last_error: None,
        }
    }
}

/// Somebody at the other end.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PeerId {
    /// Zenoh's identifier.
    pub id: String,
    /// The robot's name, for one of RECT.
    pub robot: Option<String>,
}

/// What went wrong.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trouble {
    /// In words.
    pub what: String,
    /// Seconds ago.
    pub ago_s: f64,
}

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
