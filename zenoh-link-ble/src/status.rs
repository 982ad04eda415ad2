//! Owns what the `ble` link tells of itself while it runs: links, lanes, peers. Zenoh makes the link managers and keeps
//! them to itself, so this looks them up in a list of all that live in the process.
use std::{
    collections::BTreeMap,
    sync::{Arc, Weak},
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use serde::Serialize;
use zenoh_protocol::core::Priority;

pub use crate::{
    heard::HeardStatus,
    history::{Event, PeerStatus},
    lanes::report::Count,
};
use crate::{
    lanes::{Lane, Lanes},
    link::LinkBle,
    links::LinkNumber,
    node::Node,
};

static NODES: Mutex<Vec<Weak<Node>>> = Mutex::new(Vec::new());

/// One Zenoh runtime's Bluetooth.
#[derive(Clone, Debug, Serialize)]
pub struct NodeStatus {
    /// The name it listens as; empty where it does not listen.
    pub name: String,
    /// Links that are open.
    pub links: Vec<LinkStatus>,
    /// Peers that were linked or dialled.
    pub peers: Vec<PeerStatus>,
    /// Whoever was heard within the last minute, as far as this node was looking for somebody.
    pub heard: Vec<HeardStatus>,
}

/// An open link.
#[derive(Clone, Debug, Serialize)]
pub struct LinkStatus {
    /// Its number in this process.
    pub link: u64,
    /// The peer's name, or its address where it has none.
    pub peer: String,
    /// The peer's Bluetooth address.
    pub address: String,
    /// The local adapter.
    pub adapter: String,
    /// The largest batch, in bytes.
    pub mtu: u16,
    /// Seconds since it was made.
    pub up_s: f64,
    /// Batches that went out.
    pub sent: Count,
    /// Batches that came.
    pub received: Count,
    /// What is known of a link with lanes; a plain peer has none.
    pub lanes: Option<LanesStatus>,
}

/// The lanes of a link, and the way they share.
#[derive(Clone, Debug, Serialize)]
pub struct LanesStatus {
    /// What the way to the peer carries while there is enough to send, in bytes per second.
    pub rate_bytes_per_s: Option<f64>,
    /// From an SDU to its acknowledgement, in milliseconds.
    pub round_trip_ms: Option<f64>,
    /// Sent and not acknowledged, in bytes.
    pub on_its_way_bytes: u16,
    /// How much of that there may be, in bytes.
    pub on_its_way_limit_bytes: u16,
    /// Bytes that may wait on a lane before it takes another message that must arrive.
    pub backlog_limit_bytes: usize,
    /// The lanes that had something, the most urgent first.
    pub lanes: Vec<LaneStatus>,
}

/// A lane of a link, both directions.
#[derive(Clone, Debug, Serialize)]
pub struct LaneStatus {
    /// Zenoh's priority.
    pub priority: String,
    /// Batches that went out.
    pub sent: Count,
    /// Batches that wait.
    pub waiting: Count,
    /// Bytes of them that count towards `backlog_limit_bytes`: those of messages that are not large.
    pub backlog_bytes: u64,
    /// How long the oldest of them has waited, in milliseconds.
    pub oldest_ms: Option<f64>,
    /// Batches taken back because Zenoh gave their message up.
    pub given_up: u64,
    /// The peer takes nothing of it now.
    pub is_stopped: bool,
    /// Batches that came.
    pub received: Count,
    /// Bytes that Zenoh has not taken yet.
    pub held_bytes: usize,
}

/// What each Zenoh runtime of this process tells of its Bluetooth.
pub fn nodes() -> Vec<NodeStatus> {
    let nodes: Vec<_> = NODES.lock().iter().filter_map(Weak::upgrade).collect();
    nodes.iter().map(|node| node.status()).collect()
}

/// Ends whatever this process dials by Bluetooth, for good: for a program that is about to end. Zenoh waits for its dials
/// when it is closed, and a peer that is away is dialled for seconds.
pub fn stop_dialling() {
    for node in NODES.lock().iter().filter_map(Weak::upgrade) {
        node.stop_dialling.cancel();
    }
}

/// The node on the list that is the one meant, or a new one.
pub(crate) fn find_or_add(
    is_it: impl Fn(&Node) -> bool,
    make: impl FnOnce() -> Arc<Node>,
) -> Arc<Node> {
    let mut nodes = NODES.lock();
    nodes.retain(|node| node.strong_count() > 0);
    let mut there = nodes.iter().filter_map(Weak::upgrade);
    if let Some(node) = there.find(|node| is_it(node)) {
        return node;
    }
    drop(there);
    let node = make();
    nodes.push(Arc::downgrade(&node));
    node
}

/// The open links of a node.
#[derive(Default)]
pub(crate) struct OpenLinks(BTreeMap<LinkNumber, Weak<LinkBle>>);

impl OpenLinks {
    pub(crate) fn add(&mut self, number: LinkNumber, link: &Arc<LinkBle>) {
        self.0.retain(|_, link| link.strong_count() > 0);
        self.0.insert(number, Arc::downgrade(link));
    }

    pub(crate) fn remove(&mut self, number: LinkNumber) {
        self.0.remove(&number);
    }

    /// Those that are still there. (The caller asks them when it holds no lock any more: the last to drop a link ends it.)
    pub(crate) fn all(&self) -> Vec<Arc<LinkBle>> {
        self.0.values().filter_map(Weak::upgrade).collect()
    }
}

impl LanesStatus {
    /// Of lanes as they are now, and the sums over them.
    pub(crate) fn of(lanes: &Lanes, now: Instant) -> (Self, Count, Count) {
        let (mut sent, mut received) = (Count::default(), Count::default());
        let mut used = Vec::new();
        for lane in Lane::all() {
            let (out, into) = lanes.lane_report(lane, now);
            sent = sent + out.sent;
            received = received + into.received;
            let priority = Priority::try_from(lane.number());
            if out.sent + out.waiting + into.received == Count::default() {
                continue;
            }
            used.push(LaneStatus {
                priority: priority.map_or_else(|_| lane.number().to_string(), |p| format!("{p:?}")),
                sent: out.sent,
                waiting: out.waiting,
                backlog_bytes: out.backlog_bytes,
                oldest_ms: out.oldest.map(milliseconds),
                given_up: out.given_up_sdus,
                is_stopped: out.is_stopped,
                received: into.received,
                held_bytes: into.held_bytes,
            });
        }
        let (on_its_way_bytes, on_its_way_limit_bytes) = lanes.on_its_way();
        let status = Self {
            rate_bytes_per_s: lanes.path().rate_bytes_per_s(),
            round_trip_ms: lanes.path().round_trip().map(milliseconds),
            on_its_way_bytes,
            on_its_way_limit_bytes,
            backlog_limit_bytes: lanes.backlog_limit_bytes(),
            lanes: used,
        };
        (status, sent, received)
    }
}

fn milliseconds(duration: Duration) -> f64 {
    1000.0 * duration.as_secs_f64()
}
