//! Ends a link once, regardless of which part notices the end first: logs the reason and removes the link from the table.
use std::sync::{
    atomic::{AtomicBool, Ordering},
    Arc,
};

use crate::link::{node::Node, number::LinkNumber};

/// The end of one link.
pub(crate) struct CloseOnce {
    node: Arc<Node>,
    number: LinkNumber,
    peer: String,
    is_closed: AtomicBool,
}

impl CloseOnce {
    pub(crate) fn new(node: Arc<Node>, number: LinkNumber, peer: String) -> Arc<Self> {
        Arc::new(Self {
            node,
            number,
            peer,
            is_closed: AtomicBool::new(false),
        })
    }

    /// Records that the link has ended, with the reason. The peer may be dialled again, even if Zenoh still holds the link.
    /// Only the first call has an effect.
    pub(crate) fn close(&self, reason: &str) {
        if !self.is_closed.swap(true, Ordering::AcqRel) {
            tracing::info!("ble: the link with {} ended: {reason}", self.peer);
            self.node.on_link_ended(self.number, &self.peer, reason);
        }
    }
}
