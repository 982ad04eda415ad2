//! Ends a link once, regardless of which part notices the end first: logs the reason, removes the link from the table, and
//! releases its BLE connection.
use std::sync::{
    atomic::{AtomicBool, Ordering},
    Arc,
};

use parking_lot::Mutex;

use crate::{
    connections::ConnectionGuard,
    link::{node::Node, number::LinkNumber},
};

/// The end of one link.
pub(crate) struct CloseOnce {
    node: Arc<Node>,
    number: LinkNumber,
    peer: String,
    is_closed: AtomicBool,
    connection: Mutex<Option<ConnectionGuard>>,
}

impl CloseOnce {
    pub(crate) fn new(
        node: Arc<Node>,
        number: LinkNumber,
        peer: String,
        connection: Option<ConnectionGuard>,
    ) -> Arc<Self> {
        Arc::new(Self {
            node,
            number,
            peer,
            is_closed: AtomicBool::new(false),
            connection: Mutex::new(connection),
        })
    }

    /// Records that this side ends the link: it closes the connection as soon as the link has ended.
    pub(crate) fn end_here(&self) {
        if let Some(connection) = &mut *self.connection.lock() {
            connection.end_here();
        }
    }

    /// Records that the link has ended, with the reason. The peer may be dialled again, even if Zenoh still holds the link.
    /// Only the first call has an effect.
    pub(crate) fn close(&self, reason: &str) {
        if !self.is_closed.swap(true, Ordering::AcqRel) {
            tracing::info!("ble: the link with {} ended: {reason}", self.peer);
            drop(self.connection.lock().take());
            self.node.on_link_ended(self.number, &self.peer, reason);
        }
    }
}
