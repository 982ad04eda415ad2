//! Owns what RECT adds to a router for one robot: its named connections, the registry that tells of them, the service that
//! changes them.
use std::sync::Arc;

use async_trait::async_trait;
use zenoh::{Config, Session};
use zenoh_link::{EndPoint, LinkUnicast, NewLinkChannelSender};
use zenoh_link_slot::{Dial, Slots};
use zenoh_result::ZResult;

use crate::{
    config::{self, AutoConnect, Settings},
    config_service,
    connections::{link, Connections, Watching},
    message,
    registry::Registry,
};

/// A robot whose router does not run yet.
pub struct Robot {
    /// The start of its keys.
    own: String,
    settings: Settings,
    connections: Option<Arc<Connections>>,
    fleet: Option<Arc<Slots>>,
}

/// Dropping it ends what it stands for.
pub struct Running {
    _watching: Option<Watching>,
    _registry: Registry,
    _fleet: Option<Arc<Slots>>,
}

/// Dials anyone of the fleet.
struct Anyone(EndPoint);

#[async_trait]
impl Dial for Anyone {
    async fn dial(&self, links: &NewLinkChannelSender) -> ZResult<LinkUnicast> {
        link(links, &self.0).await
    }
}

impl Robot {
    /// Makes room in the configuration for connections that come while the router runs.
    pub fn prepare(settings: Settings, config: &mut Config) -> zenoh::Result<Self> {
        config::announce(config, &settings.fleet)?;
        let is_listed = settings.auto_connect != AutoConnect::None;
        let file = settings.connections.as_ref().filter(|_| is_listed);
        let connections = file.map(|path| Connections::new(path, settings.max_connections));
        if let Some(connections) = &connections {
            config::dial(config, connections.endpoints())?;
        }
        let mut fleet = None;
        if settings.auto_connect == AutoConnect::Fleet {
            let slots = Slots::new(settings.auto_links);
            let anyone: EndPoint = format!("ble/*#fleet={}", settings.fleet).parse()?;
            for slot in 0..slots.count() {
                slots.set(slot, Some(Arc::new(Anyone(anyone.clone()))));
            }
            config::dial(config, slots.endpoints())?;
            fleet = Some(slots);
        }
        Ok(Self {
            fleet,
            own: format!("{}/{}/@rect", settings.fleet, settings.robot),
            settings,
            connections,
        })
    }

    /// Dials the connections of the file and answers questions. A file that can't be taken is no reason not to: whoever
    /// mends it may need this router for it. `session` answers; `host`: another one of this process with
    /// links to tell of.
    pub fn start(self, session: &Session, host: Option<Session>) -> zenoh::Result<Running> {
        let mut watching = None;
        if let Some(connections) = &self.connections {
            watching = begin(connections);
            config_service::serve(session, &self.own, Arc::clone(connections))?;
        }
        let registry = Registry::serve(session, host, &self.own, &self.settings, self.connections)?;
        Ok(Running {
            _watching: watching,
            _registry: registry,
            _fleet: self.fleet,
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
