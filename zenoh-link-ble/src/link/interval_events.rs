//! Reports to the node what concerns the connection interval of one link: a message of the peer, and that the radio neglects
//! or has lost the link.
use std::sync::Arc;
use zenoh_link_ble_radio::interval::ConnectionInterval;

use crate::link::{node::Node, table::LinkNumber};

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

    /// Reports that the radio has sent nothing for a long time, although there was data to send.
    pub(crate) fn on_starved(&self) {
        let action = self.node.intervals().on_starved(self.number);
        self.node.perform(action);
    }

    /// Reports that the radio has lost the link.
    pub(crate) fn on_lost(&self) {
        self.node.intervals().on_lost(self.number);
    }
}
