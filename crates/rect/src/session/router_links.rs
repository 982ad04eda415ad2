//! Keeps track of the links of this robot's router.
use std::sync::{Arc, Mutex, PoisonError};

use rect_core::{
    name::{key::KeySpace, Name},
    registry::{
        connection::{Connection, Links},
        observer::RouterObserver,
    },
};
use tokio::runtime::Handle;
use zenoh::Session;

use super::{
    executor::{Executor, Running},
    shared::Sink,
};
use crate::error::Error;

/// The links of this robot's router, as reported by its registry. Without a registry, they remain unknown.
pub(super) struct RouterLinks {
    links: LinkTable,
    _running: Running<RouterObserver>,
}

/// The links that were reported last. Clones share them.
#[derive(Clone, Default)]
pub(super) struct LinkTable(Arc<Mutex<Links>>);

impl RouterLinks {
    pub(super) fn follow(
        session: &Session,
        place: &KeySpace,
        runtime: &Handle,
    ) -> Result<Self, Error> {
        let links = LinkTable::default();
        let executor = Executor::new(session, RouterObserver::new(place), links.clone());
        Ok(Self {
            links,
            _running: executor.start(runtime)?,
        })
    }

    pub(super) fn table(&self) -> LinkTable {
        self.links.clone()
    }
}

impl LinkTable {
    /// Returns the method of the links to a robot, if it is known and the same for all of them.
    pub(super) fn method(&self, robot: &Name) -> Option<String> {
        let links = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        links.method(robot).map(str::to_owned)
    }
}

impl Sink<Vec<Connection>> for LinkTable {
    fn deliver(&self, connections: Vec<Connection>) {
        let mut links = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        links.on_connections(&connections);
    }
}
