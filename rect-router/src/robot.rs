//! Owns what RECT adds to a router for one robot: its named connections, the registry that tells of them, the service that
//! changes them.
use std::sync::Arc;

use zenoh::{Config, Session};

use crate::{
    config::{self, Settings},
    config_service,
    connections::{Connections, Watching},
    message,
    registry::Registry,
};

/// A robot whose router does not run yet.
pub struct Robot {
    /// The start of its keys.
    own: String,
    settings: Settings,
    connections: Option<Arc<Connections>>,
}

/// Dropping it ends what it stands for.
pub struct Running {
    _watching: Option<Watching>,
    _registry: Registry,
}

impl Robot {
    /// Makes room in the configuration for connections that come while the router runs.
    pub fn prepare(settings: Settings, config: &mut Config) -> zenoh::Result<Self> {
        let file = settings.connections.as_ref();
        let connections = file.map(|path| Connections::new(path, settings.max_connections));
        if let Some(connections) = &connections {
            config::dial(config, connections.endpoints())?;
        }
        Ok(Self {
            own: format!("{}/{}/@rect", settings.fleet, settings.robot),
            settings,
            connections,
        })
    }

    /// Dials the connections of the file and answers questions. A file that can't be taken is no reason not to: whoever
    /// mends it may need this router for it. `sessions`: of this process, with links to tell of; the first answers.
    pub fn start(self, sessions: Vec<Session>) -> zenoh::Result<Running> {
        let mut watching = None;
        if let (Some(connections), Some(session)) = (&self.connections, sessions.first()) {
            watching = begin(connections);
            config_service::serve(session, &self.own, Arc::clone(connections))?;
        }
        let registry = Registry::serve(sessions, &self.own, &self.settings, self.connections)?;
        Ok(Running {
            _watching: watching,
            _registry: registry,
        })
    }
}

/// Dials what is in the file, and whatever will be.
fn begin(connections: &Arc<Connections>) -> Option<Watching> {
    let path = connections.path().display();
    match connections.load() {
        Ok(changes) => tracing::info!("{path}: {changes}"),
        Err(error) => tracing::error!(
            "{}; there are no named connections until it is mended",
            message::with_causes(&error)
        ),
    }
    connections
        .watch()
        .inspect_err(|error| {
            let why = message::with_causes(error);
            tracing::error!("{path}: changes are not noticed: {why}");
        })
        .ok()
}
