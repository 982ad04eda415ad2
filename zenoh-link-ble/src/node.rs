//! Owns what all listeners and dials of one Zenoh runtime share: who this node is, its links, its adapters.
use std::{collections::HashMap, sync::Arc};

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::Notify;

use crate::{
    adapter::Adapter,
    hello::NodeId,
    links::{LinkNumber, Links},
    radio::{Radio, RadioError},
};

/// Opens the radio of that name (`None`: the system's default one).
pub(crate) type OpenRadio =
    dyn Fn(Option<&str>) -> Result<Arc<dyn Radio>, RadioError> + Send + Sync;

pub(crate) struct Node {
    pub(crate) id: NodeId,
    links: Mutex<Links>,
    /// Told whenever a link ends.
    pub(crate) unlinked: Notify,
    adapters: Mutex<HashMap<String, Arc<Adapter>>>,
    listening: Mutex<Vec<Listening>>,
    open_radio: Box<OpenRadio>,
}

/// What a dial takes from this node's listener: where it listens, and as whom.
#[derive(Clone)]
pub(crate) struct Listening {
    pub adapter: String,
    pub name: String,
}

impl Node {
    pub(crate) fn new(id: NodeId, open_radio: Box<OpenRadio>) -> Arc<Self> {
        Arc::new(Self {
            id,
            links: Mutex::new(Links::new(id)),
            unlinked: Notify::new(),
            adapters: Mutex::default(),
            listening: Mutex::default(),
            open_radio,
        })
    }

    pub(crate) fn links(&self) -> MutexGuard<'_, Links> {
        self.links.lock()
    }

    pub(crate) fn on_link_closed(&self, link: LinkNumber) {
        self.links().on_closed(link);
        // What was heard before says nothing now: the peer may have gone for good, and a connect would wait for it.
        for adapter in self.adapters.lock().values() {
            adapter.scanner.forget();
        }
        self.unlinked.notify_waiters();
    }

    /// The adapter of that name; left out, the one this node listens on, else the system's default.
    pub(crate) fn adapter(&self, name: Option<&str>) -> Result<Arc<Adapter>, RadioError> {
        let listened = self.listening.lock().first().map(|l| l.adapter.clone());
        let name = name.map(str::to_owned).or(listened);
        let mut adapters = self.adapters.lock();
        let key = name.clone().unwrap_or_default();
        if let Some(adapter) = adapters.get(&key) {
            return Ok(Arc::clone(adapter));
        }
        let adapter = Adapter::new((self.open_radio)(name.as_deref())?);
        adapters.insert(key, Arc::clone(&adapter));
        Ok(adapter)
    }

    pub(crate) fn on_listening(&self, listening: Listening) {
        self.listening.lock().push(listening);
    }

    pub(crate) fn on_listening_ended(&self, adapter: &str) {
        self.listening.lock().retain(|l| l.adapter != adapter);
    }

    /// The name this node goes by when it dials: its listener's; empty for one that does not listen.
    pub(crate) fn name(&self) -> String {
        self.listening
            .lock()
            .first()
            .map_or_else(String::new, |l| l.name.clone())
    }

    /// What distinguishes this run's advertisement from an earlier one's.
    pub(crate) fn incarnation(&self) -> u16 {
        (self.id.0 & 0xffff) as u16
    }
}
