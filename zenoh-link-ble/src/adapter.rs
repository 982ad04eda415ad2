//! Owns one local adapter as this node uses it: its radio, its one scan, its one pending connect.
use std::sync::Arc;

use tokio::sync::Semaphore;

use crate::{radio::Radio, scanner::Scanner};

pub(crate) struct Adapter {
    pub(crate) radio: Arc<dyn Radio>,
    pub(crate) scanner: Arc<Scanner>,
    /// One pending LE connect at a time: a second one leaks a connection on the Pi's controller
    /// (bluetooth-next#643), and the kernel serves only one anyway.
    pub(crate) connecting: Semaphore,
}

impl Adapter {
    pub(crate) fn new(radio: Arc<dyn Radio>) -> Arc<Self> {
        Arc::new(Self {
            scanner: Scanner::new(Arc::clone(&radio)),
            radio,
            connecting: Semaphore::new(1),
        })
    }
}
