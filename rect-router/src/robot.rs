//! Owns what RECT adds to a router for one robot: its named connections, the registry that tells of them, the service that
//! changes them.
use std::sync::Arc;

use rect::core::wording;
use zenoh::{Config, Session, Wait};
use zenoh_link::ble;

use crate::{
    config::{self, AutoConnect, Settings, MAX_AUTO_LINKS},
    config_service,
    connections::{Connections, Fleet, Watching},
    registry::Registry,
    topics,
};

/// A robot whose router does not run yet.
pub struct Robot {
    /// The start of its keys.
    own: String,
    settings: Settings,
    connections: Option<Arc<Connections>>,
    fleet: Arc<Fleet>,
}

/// Dropping it ends what it stands for.
pub struct Running {
    connections: Option<Arc<Connections>>,
    fleet: Arc<Fleet>,
    _watching: Option<Watching>,
    _registry: Registry,
}

impl Drop for Running {
    fn drop(&mut self) {
        self.fleet.close();
        if let Some(connections) = &self.connections {
            connections.close();
        }
    }
}

/// Closes a router. Zenoh waits for its dials before it takes leave of anybody, so they are ended first.
pub fn close(session: &Session, running: Option<Running>) -> zenoh::Result<()> {
    drop(running);
    ble::status::stop_dialling();
    session.close().wait()
}

impl Robot {
    /// Makes room in the configuration for connections that come while the router runs.
    pub fn prepare(settings: Settings, config: &mut Config) -> zenoh::Result<Self> {
        config::announce(config, &settings.fleet)?;
        // Where there is a file, it may say so later.
        let most = match (&settings.connections, settings.auto_connect) {
            (Some(_), _) => MAX_AUTO_LINKS,
            (None, AutoConnect::Fleet) => settings.auto_links,
            (None, AutoConnect::None | AutoConnect::Listed) => 0,
        };
        let fleet = Fleet::new(&settings.fleet, most)?;
        config::dial(config, fleet.endpoints())?;
        let file = settings.connections.as_deref();
        let connections = file.map(|path| Connections::new(path, &settings, Arc::clone(&fleet)));
        if let Some(connections) = &connections {
            config::dial(config, connections.endpoints())?;
        }
        Ok(Self {
            fleet,
            own: format!("{}/{}/@rect", settings.fleet, settings.robot),
            settings,
            connections,
        })
    }

    /// Whether the file of connections can be taken.
    pub fn check(&self) -> zenoh::Result<()> {
        match &self.connections {
            Some(connections) => Ok(connections.check()?),
            None => Ok(()),
        }
    }

    /// Dials the connections of the file and answers questions. A file that can't be taken is no reason not to: whoever
    /// mends it may need this router for it. `session` answers; `host`: another one of this process with
    /// links to tell of.
    pub fn start(self, session: &Session, host: Option<Session>) -> zenoh::Result<Running> {
        // The file may say otherwise.
        self.fleet.follow(self.settings.rule());
        let mut watching = None;
        if let Some(connections) = &self.connections {
            watching = begin(connections);
            config_service::serve(session, &self.own, Arc::clone(connections))?;
        }
        let (own, settings) = (&self.own, &self.settings);
        let keys = format!("{}/{}", settings.fleet, settings.robot);
        topics::serve(session, host.as_ref(), &keys)?;
        let (connections, fleet) = (self.connections.clone(), Arc::clone(&self.fleet));
        let registry = Registry::serve(session, host, own, settings, self.connections, self.fleet)?;
        Ok(Running {
            connections,
            fleet,
            _watching: watching,
            _registry: registry,
        })
    }
}

/// Dials what is in the file, and whatever will be.
fn begin(connections: &Arc<Connections>) -> Option<Watching> {
    let path = connections.path().display();
    connections.remove_leftovers();
    match connections.load() {
        Ok(changes) => tracing::info!("{path}: {changes}"),
        Err(error) => tracing::error!(
            "{}; there are no named connections until it is mended",
            wording::with_causes(&error)
        ),
    }
    connections
        .watch()
        .inspect_err(|error| {
            let why = wording::with_causes(error);
            tracing::error!("{path}: changes are not noticed: {why}");
        })
        .ok()
}
