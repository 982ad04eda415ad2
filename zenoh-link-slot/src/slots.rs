//! Owns the slots: which there are, and what is in each.
use std::{
    collections::HashMap,
    sync::{
        atomic::{AtomicU32, Ordering},
        Arc, LazyLock, Weak,
    },
};

use async_trait::async_trait;
use parking_lot::{Mutex, RwLock};
use tokio::sync::watch;
use zenoh_link_commons::{LinkUnicast, NewLinkChannelSender};
use zenoh_result::ZResult;

use crate::SLOT_LOCATOR_PREFIX;

/// Makes a link, each time it is asked.
#[async_trait]
pub trait Dial: Send + Sync {
    /// One attempt. Zenoh drops it after its `open_timeout` (10 s by default) and asks again after its pause. `links` is
    /// the channel of this Zenoh runtime: what a link manager of the real protocol is made with.
    async fn dial(&self, links: &NewLinkChannelSender) -> ZResult<LinkUnicast>;
}

/// What is dialled in a slot; `None`: nothing for now.
pub(crate) type Dialled = Option<Arc<dyn Dial>>;

/// A fixed number of slots of one Zenoh runtime.
pub struct Slots {
    table: u32,
    /// None, once they are closed.
    slots: RwLock<Box<[watch::Sender<Dialled>]>>,
}

/// Zenoh's link managers are made from a locator alone, so the tables of a process have one register.
static TABLES: LazyLock<Mutex<HashMap<u32, Weak<Slots>>>> = LazyLock::new(Mutex::default);
static NEXT: AtomicU32 = AtomicU32::new(0);

impl Slots {
    /// So many, all empty. Dropping them ends dialling, not the links.
    pub fn new(count: usize) -> Arc<Self> {
        let slots = Arc::new(Self {
            table: NEXT.fetch_add(1, Ordering::Relaxed),
            slots: RwLock::new((0..count).map(|_| watch::channel(None).0).collect()),
        });
        TABLES.lock().insert(slots.table, Arc::downgrade(&slots));
        slots
    }

    /// The endpoints to put under `connect/endpoints`.
    pub fn endpoints(&self) -> impl Iterator<Item = String> + '_ {
        let endpoint = |number| format!("{SLOT_LOCATOR_PREFIX}/{}.{number}", self.table);
        (0..self.count()).map(endpoint)
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.slots.read().len()
    }

    /// What is dialled in that slot from now on. An attempt under way for what was in it before is given up.
    pub fn set(&self, number: usize, dialled: Option<Arc<dyn Dial>>) {
        if let Some(slot) = self.slots.read().get(number) {
            slot.send_replace(dialled);
        }
    }

    /// Ends dialling for good, not the links. Zenoh waits for its dials when it is closed; that of an empty slot would take
    /// until Zenoh drops it.
    pub fn close(&self) {
        *self.slots.write() = Box::default();
    }

    /// The slot of that address (`<table>.<number>`), to be watched.
    pub(crate) fn of_address(address: &str) -> Option<watch::Receiver<Dialled>> {
        let (table, number) = address.split_once('.')?;
        let tables = TABLES.lock();
        let slots = tables.get(&table.parse().ok()?)?.upgrade()?;
        let slots = slots.slots.read();
        Some(slots.get(number.parse::<usize>().ok()?)?.subscribe())
    }
}

impl Drop for Slots {
    fn drop(&mut self) {
        TABLES.lock().remove(&self.table);
    }
}
