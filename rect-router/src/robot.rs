//! Owns what RECT adds to a router for one robot: its named connections, and the registry that tells of them.
use std::sync::Arc;

use zenoh::{Config, Session};

use crate::{
    config::{self, ConfigError, Settings},
    connections::{Connections, Watching},
    message,
    registry::Registry,
};

/// A robot whose router does not run yet.
pub struct Robot {
    settings: Settings,
    connections: Arc<Connections>,
}

/// Dropping it ends what it stands for.
pub struct Running {
    _watching: Option<Watching>,
    _registry: Registry,
}

impl Robot {
    /// Makes room in the configuration for connections that come while the router runs.
    pub fn prepare(settings: Settings, config: &mut Config) -> Result<Self, ConfigError> {
        let connections = Connections::new(settings.max_connections);
        if settings.connections.is_some() {
            config::dial(config, connections.endpoints())?;
        }
        Ok(Self {
            settings,
            connections,
        })
    }

    /// Dials the connections of the file and answers questions. A file that can't be taken is no reason not to: whoever
    /// mends it may need this router for it.
    pub fn start(self, session: &Session) -> zenoh::Result<Running> {
        let mut watching = None;
        if let Some(path) = &self.settings.connections {
            match self.connections.load(path) {
                Ok(changes) => tracing::info!("{}: {changes}", path.display()),
                Err(error) => tracing::error!(
                    "{}; there are no named connections until it is mended",
                    message::with_causes(&error)
                ),
            }
            match self.connections.watch(path) {
                Ok(watch) => watching = Some(watch),
                Err(error) => tracing::error!(
                    "{}: changes are not noticed: {}",
                    path.display(),
                    message::with_causes(&error)
                ),
            }
        }
        let registry = Registry::serve(session, &self.settings, self.connections)?;
        Ok(Running {
            _watching: watching,
            _registry: registry,
        })
    }
}
