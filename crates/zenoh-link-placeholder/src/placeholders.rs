//! Keeps the tables of placeholders and what each placeholder dials at the moment.
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

use crate::PLACEHOLDER_LOCATOR_PREFIX;

/// Opens links to one peer.
#[async_trait]
pub trait Dial: Send + Sync {
    /// Makes one attempt to open a link.
    ///
    /// Zenoh drops the attempt after its `open_timeout` (10 s by default) and retries after its `connect/retry` period.
    /// `links` is the channel on which this Zenoh runtime receives new links; link managers of the real protocol are
    /// constructed with it.
    ///
    /// # Errors
    /// The reason why the peer could not be reached.
    async fn dial(&self, links: &NewLinkChannelSender) -> ZResult<LinkUnicast>;
}

/// The dialler in a placeholder; `None` while it is empty.
pub(crate) type Target = Option<Arc<dyn Dial>>;

/// A table with a fixed number of placeholders for one Zenoh runtime.
pub struct Placeholders {
    table: u32,
    /// Empty once the table is closed.
    placeholders: RwLock<Box<[watch::Sender<Target>]>>,
}

/// All tables of the process by number: Zenoh constructs a link manager from a locator alone.
static TABLES: LazyLock<Mutex<HashMap<u32, Weak<Placeholders>>>> = LazyLock::new(Mutex::default);
static NEXT: AtomicU32 = AtomicU32::new(0);

impl Placeholders {
    /// Creates a table of `count` empty placeholders. Dropping it stops dialling; links that are open stay open.
    pub fn new(count: usize) -> Arc<Self> {
        let placeholders = Arc::new(Self {
            table: NEXT.fetch_add(1, Ordering::Relaxed),
            placeholders: RwLock::new((0..count).map(|_| watch::channel(None).0).collect()),
        });
        TABLES
            .lock()
            .insert(placeholders.table, Arc::downgrade(&placeholders));
        placeholders
    }

    /// Returns the endpoints to add to Zenoh's `connect/endpoints`.
    pub fn endpoints(&self) -> impl Iterator<Item = String> + '_ {
        let endpoint = |number| format!("{PLACEHOLDER_LOCATOR_PREFIX}/{}.{number}", self.table);
        (0..self.count()).map(endpoint)
    }

    /// Returns the number of placeholders; 0 once the table is closed.
    pub fn count(&self) -> usize {
        self.placeholders.read().len()
    }

    /// Sets what placeholder `number` dials from now on; `None` empties it. An attempt in progress is abandoned. A number
    /// that is out of range is ignored.
    pub fn set(&self, number: usize, target: Option<Arc<dyn Dial>>) {
        if let Some(placeholder) = self.placeholders.read().get(number) {
            placeholder.send_replace(target);
        }
    }

    /// Stops dialling for good; links that are open stay open.
    ///
    /// Call it before closing Zenoh, which waits for its dials: the dial of an empty placeholder would last until Zenoh's
    /// `open_timeout`.
    pub fn close(&self) {
        *self.placeholders.write() = Box::default();
    }

    /// Returns a receiver for the target of the placeholder at `address` (`<table>.<number>`), or `None` if there is no such
    /// placeholder.
    pub(crate) fn of_address(address: &str) -> Option<watch::Receiver<Target>> {
        let (table, number) = address.split_once('.')?;
        let tables = TABLES.lock();
        let placeholders = tables.get(&table.parse().ok()?)?.upgrade()?;
        let placeholders = placeholders.placeholders.read();
        Some(placeholders.get(number.parse::<usize>().ok()?)?.subscribe())
    }
}

impl Drop for Placeholders {
    fn drop(&mut self) {
        TABLES.lock().remove(&self.table);
    }
}
