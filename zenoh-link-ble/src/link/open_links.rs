//! Keeps the open links of a node, for its status.
use std::{
    collections::BTreeMap,
    sync::{Arc, Weak},
};

use crate::link::{number::LinkNumber, LinkBle};

/// The open links of a node.
#[derive(Default)]
pub(crate) struct OpenLinks(BTreeMap<LinkNumber, Weak<LinkBle>>);

impl OpenLinks {
    pub(crate) fn add(&mut self, number: LinkNumber, link: &Arc<LinkBle>) {
        self.0.retain(|_, link| link.strong_count() > 0);
        self.0.insert(number, Arc::downgrade(link));
    }

    pub(crate) fn remove(&mut self, number: LinkNumber) {
        self.0.remove(&number);
    }

    /// Returns a link, if it still exists. The caller must use and drop it without holding a lock.
    pub(crate) fn get(&self, number: LinkNumber) -> Option<Arc<LinkBle>> {
        self.0.get(&number).and_then(Weak::upgrade)
    }

    /// Returns the links that still exist. The caller must use and drop them without holding a lock, because dropping the
    /// last reference ends a link.
    pub(crate) fn all(&self) -> Vec<Arc<LinkBle>> {
        self.0.values().filter_map(Weak::upgrade).collect()
    }
}
