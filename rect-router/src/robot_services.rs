//! Starts and stops what RECT adds to the router of a robot: its named connections, the registry that reports them, the
//! config service that changes them, the catalogue of its programs, and the answers about their topics.
use std::{sync::Arc, time::Instant};

use parking_lot::Mutex;
use rect::{KeptLog, KeptState, RunningThrottle};
use rect_connections::{AutoConnect, MAX_AUTO_LINKS};
use rect_core::{
    catalogue::keeper::Keeper,
    name::{key::KeySpace, topic::Topic, Name},
    state::keeper::IsServed,
    text::humanize,
};
use zenoh::{pubsub::Subscriber, Config, Session, Wait};

use crate::{
    catalogue,
    config::{self, Settings},
    config_service,
    connections::{Connections, FileWatch, FleetConnector},
    registry::Registry,
    state, topics,
};

/// The services of a robot whose router does not run yet.
pub struct RobotServices {
    /// The prefix of the services' keys: `<fleet>/<robot>/@rect`.
    own: String,
    settings: Settings,
    connections: Option<Arc<Connections>>,
    fleet: Arc<FleetConnector>,
}

/// The running services of a robot. Dropping them stops dialling and publishing.
pub struct RunningServices {
    connections: Option<Arc<Connections>>,
    fleet: Arc<FleetConnector>,
    _watching: Option<FileWatch>,
    _registry: Registry,
    _state: Arc<KeptState>,
    _log: KeptLog,
    _throttle: RunningThrottle,
    _prefix: Subscriber<()>,
}

impl Drop for RunningServices {
    fn drop(&mut self) {
        self.fleet.close();
        if let Some(connections) = &self.connections {
            connections.close();
        }
    }
}

/// Closes a router and its services.
///
/// Stops all dials first: Zenoh waits for its dials before it closes its sessions.
///
/// # Errors
/// Zenoh's error if the session could not be closed.
pub fn close(session: &Session, running: Option<RunningServices>) -> zenoh::Result<()> {
    drop(running);
    zenoh_link_ble::status::stop_dialling();
    session.close().wait()
}

impl RobotServices {
    /// Prepares the services and adds placeholder endpoints to `config` for connections that are made while the router
    /// runs.
    ///
    /// # Errors
    /// Fails if an endpoint of the configuration or the fleet's name is invalid.
    pub fn prepare(mut settings: Settings, config: &mut Config) -> zenoh::Result<Self> {
        settings.adapters = config::adapters(config);
        config::announce(config, &settings.fleet)?;
        // A connections file may enable `auto_connect: "fleet"` later.
        let max_links = match (&settings.connections, settings.auto_connect) {
            (Some(_), _) => MAX_AUTO_LINKS,
            (None, AutoConnect::Fleet) => settings.auto_links,
            (None, AutoConnect::None | AutoConnect::Listed) => 0,
        };
        let fleet = FleetConnector::new(&settings.fleet, max_links)?;
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

    /// Checks the connections file, if there is one.
    ///
    /// # Errors
    /// The first problem found in the file.
    pub fn check(&self) -> zenoh::Result<()> {
        match &self.connections {
            Some(connections) => Ok(connections.check()?),
            None => Ok(()),
        }
    }

    /// Dials the connections of the file and starts answering queries.
    ///
    /// An invalid connections file is logged and does not prevent the start: the person who corrects it may need this
    /// router to do so. Queries are answered on `session`. `host` is the session of another router in this process whose
    /// links are reported too.
    ///
    /// # Errors
    /// Zenoh's error if a queryable or subscriber could not be declared.
    pub fn start(self, session: &Session, host: Option<Session>) -> zenoh::Result<RunningServices> {
        // This rule applies until the file is loaded, which may override it.
        self.fleet.apply_rule(self.settings.rule());
        let mut watching = None;
        if let Some(connections) = &self.connections {
            watching = begin(connections);
            config_service::serve(session, &self.own, Arc::clone(connections))?;
        }
        let (own, settings) = (&self.own, &self.settings);
        let keys = format!("{}/{}", settings.fleet, settings.robot);
        let (place, programs) = (place(settings)?, Arc::default());
        let state = Arc::new(state::serve(
            session,
            place.clone(),
            settings,
            is_served(&programs),
        )?);
        let retaining = Arc::downgrade(&state);
        let retained = move || {
            let state = retaining.upgrade();
            state.map(|state| state.topics()).unwrap_or_default()
        };
        topics::serve(session, &keys, Box::new(retained))?;
        let retaining = Arc::downgrade(&state);
        let is_retained = move |topic: &Topic| {
            let state = retaining.upgrade();
            state.is_some_and(|state| state.has(topic))
        };
        let log = KeptLog::start(session, place.clone())?;
        let throttle = RunningThrottle::start(session, place.clone())?;
        catalogue::serve(session, &place, &programs, Box::new(is_retained))?;
        let (connections, fleet) = (self.connections.clone(), Arc::clone(&self.fleet));
        let alerting = Arc::downgrade(&state);
        let alerts = Box::new(move || {
            let state = alerting.upgrade();
            state.map(|state| state.alerts()).unwrap_or_default()
        });
        let registry = Registry::serve(
            session,
            host,
            own,
            settings,
            self.connections,
            self.fleet,
            alerts,
        )?;
        Ok(RunningServices {
            connections,
            fleet,
            _watching: watching,
            _registry: registry,
            _state: state,
            _log: log,
            _throttle: throttle,
            _prefix: declare_prefix(session, &keys)?,
        })
    }
}

/// Makes Zenoh give the beginning of the robot's keys, `<fleet>/<robot>`, a number on each link, when the link begins. Subscriptions with a
/// wildcard in place of the robot would otherwise cost the text in each message. Zenoh declares the part of a key before its first wildcard;
/// no message matches this one.
fn declare_prefix(session: &Session, keys: &str) -> zenoh::Result<Subscriber<()>> {
    let subscriber = session.declare_subscriber(format!("{keys}/*/@rect/none"));
    subscriber.callback(|_| ()).wait()
}

/// Returns whether a program serves a topic.
fn is_served(programs: &Arc<Mutex<Keeper>>) -> IsServed {
    let programs = Arc::clone(programs);
    Box::new(move |topic| {
        let programs = programs.lock().programs(Instant::now());
        programs.iter().any(|program| program.serves(topic))
    })
}

/// Returns the keys of the robot.
fn place(settings: &Settings) -> zenoh::Result<KeySpace> {
    Ok(KeySpace {
        fleet: Name::new(&settings.fleet)?,
        robot: Name::new(&settings.robot)?,
    })
}

/// Dials the connections of the file now, and again whenever the file changes.
fn begin(connections: &Arc<Connections>) -> Option<FileWatch> {
    let path = connections.path().display();
    connections.remove_leftovers();
    match connections.load() {
        Ok(changes) => tracing::info!("{path}: {changes}"),
        Err(error) => tracing::error!(
            "{}; the router runs without named connections until the file is corrected",
            humanize::with_causes(&error)
        ),
    }
    connections
        .watch()
        .inspect_err(|error| {
            let why = humanize::with_causes(error);
            tracing::error!("{path}: cannot watch the file, so changes take effect at the next start only: {why}");
        })
        .ok()
}
