//! Owns that a link ends once: it is said once, and the table of links forgets it, whoever notices first.
use std::sync::{
    atomic::{AtomicBool, Ordering},
    Arc,
};

use crate::{links::LinkNumber, node::Node};

pub(crate) struct Ending {
    node: Arc<Node>,
    number: LinkNumber,
    peer: String,
    has_happened: AtomicBool,
}

impl Ending {
    pub(crate) fn of(node: Arc<Node>, number: LinkNumber, peer: String) -> Arc<Self> {
        Arc::new(Self {
            node,
            number,
            peer,
            has_happened: AtomicBool::new(false),
        })
    }

    /// The link is of no use any more, even if Zenoh holds on to it for a while: the peer may be dialled again.
    pub(crate) fn happens(&self, reason: &str) {
        if !self.has_happened.swap(true, Ordering::AcqRel) {
            tracing::info!("ble: the link with {} ended: {reason}", self.peer);
            self.node.on_link_ended(self.number, &self.peer, reason);
        }
    }

    /// Zenoh has let the link go.
    pub(crate) fn released(&self) {
        self.node.on_link_released(self.number);
    }
}
