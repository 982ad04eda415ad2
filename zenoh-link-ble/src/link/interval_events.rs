//! Reports to the node what concerns the connection interval of one link: a message of the peer, and the loss of the link by
//! the radio.
use std::sync::Arc;

use crate::{
    interval::ConnectionInterval,
    link::{node::Node, table::LinkNumber},
};

/// Reports the events of one link.
pub(crate) struct IntervalEvents {
    node: Arc<Node>,
    number: LinkNumber,
}

impl IntervalEvents {
    pub(crate) fn new(node: Arc<Node>, number: LinkNumber) -> Self {
        Self { node, number }
    }

    /// Reports that the peer has set or requests an interval.
    pub(crate) fn on_message(&self, interval: ConnectionInterval) {
        let action = self.node.intervals().on_message(self.number, interval);
        self.node.perform(action);
    }

    /// Reports that the radio has lost the link.
    pub(crate) fn on_lost(&self) {
        self.node.intervals().on_lost(self.number);
    }
}
