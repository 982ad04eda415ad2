//! Reports the state of all `ble` links of the process: links, lanes, peers and discovered nodes. Zenoh creates the link
//! managers and does not expose them, so the nodes are kept in a list for the whole process.
use std::{
    sync::{Arc, Weak},
    time::Duration,
};

use parking_lot::Mutex;

use crate::link::node::Node;

pub use crate::{
    discovered::DiscoveredStatus,
    link::{
        history::{Event, PeerStatus},
        status::{LaneStatus, LanesStatus, LinkStatus, LinkUsage, NodeStatus},
    },
    refusals::RefusedStatus,
};

static NODES: Mutex<Vec<Weak<Node>>> = Mutex::new(Vec::new());

/// Returns the state of the `ble` links of each Zenoh runtime in this process.
pub fn nodes() -> Vec<NodeStatus> {
    let nodes: Vec<_> = NODES.lock().iter().filter_map(Weak::upgrade).collect();
    nodes.iter().map(|node| node.status()).collect()
}

/// Returns what each link of this process has sent for each key. The links count from the first question on until `keep` after the
/// last one.
pub fn usage(keep: Duration) -> Vec<LinkUsage> {
    let nodes: Vec<_> = NODES.lock().iter().filter_map(Weak::upgrade).collect();
    nodes.iter().flat_map(|node| node.usage(keep)).collect()
}

/// Cancels all `ble` dials of this process and prevents new ones. It is for a program that is about to exit: Zenoh
/// waits for its dials when it is closed, and a dial to an unreachable peer takes seconds.
pub fn stop_dialling() {
    for node in NODES.lock().iter().filter_map(Weak::upgrade) {
        node.stop_dialling.cancel();
    }
}

/// Returns the node in the list for which `matches` returns `true`, or adds a new one.
pub(crate) fn find_or_add(
    matches: impl Fn(&Node) -> bool,
    make: impl FnOnce() -> Arc<Node>,
) -> Arc<Node> {
    let mut nodes = NODES.lock();
    nodes.retain(|node| node.strong_count() > 0);
    let mut alive = nodes.iter().filter_map(Weak::upgrade);
    if let Some(node) = alive.find(|node| matches(node)) {
        return node;
    }
    drop(alive);
    let node = make();
    nodes.push(Arc::downgrade(&node));
    node
}
