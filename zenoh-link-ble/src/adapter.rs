//! Represents one local adapter of a node: its radio, its shared scan, its limit of one pending connect, and its connections.
use std::sync::Arc;

use tokio::sync::Semaphore;
use zenoh_link_ble_radio::Radio;

use crate::{connections::AdapterConnections, scanner::Scanner};

/// A local adapter, as all listeners and dials of a node share it.
pub(crate) struct Adapter {
    pub(crate) radio: Arc<dyn Radio>,
    pub(crate) scanner: Arc<Scanner>,
    /// Limits pending LE connects to one at a time. A second one leaks a connection on the Pi's controller
    /// (bluetooth-next#643), and the kernel serves only one anyway.
    pub(crate) connecting: Semaphore,
    pub(crate) connections: Arc<AdapterConnections>,
}

impl Adapter {
    pub(crate) fn new(radio: Arc<dyn Radio>) -> Arc<Self> {
        Arc::new(Self {
            scanner: Scanner::new(Arc::clone(&radio)),
            connecting: Semaphore::new(1),
            connections: AdapterConnections::new(Arc::clone(&radio)),
            radio,
        })
    }
}
