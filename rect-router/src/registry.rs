//! Implements the registry of a robot, which reports its connections, its peers and its status.
//!
//! Zenoh queryables answer queries, changes of the connections are published under the key that answers for them, and a
//! liveliness token shows that the robot is present. `docs/reference/registry.md` documents the keys.
pub mod document;
mod presence;
mod publisher;
mod radio;
mod silence;
mod sockets;
mod uptime;

use std::{
    collections::{HashMap, HashSet},
    net::SocketAddr,
    sync::{mpsc, Arc, Weak},
    thread,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use rect_core::{
    alert::query::RobotAlert,
    registry::{
        connection::{Connection, ConnectionState as State, Failure, PeerId, Traffic},
        selector::Selector,
    },
    text::humanize,
};
use serde::Serialize;
use zenoh::{query::Query, session::Link, Session, Wait};
use zenoh_link_any::{locator::has_radio, observers};
use zenoh_link_ble::{
    status::{DiscoveredStatus, RefusedStatus},
    BLE_LOCATOR_PREFIX as BLE,
};
use zenoh_link_ble_bluez::management;
use zenoh_link_ble_radio::advertisement::Advertisement;
use zenoh_link_table::admission::delayed_declarations;

use self::{
    document::{peers, Clock, Counts, Status},
    presence::Presence,
    publisher::{publish, Change},
    radio::Radio,
    silence::Silence,
    sockets::Sockets,
    uptime::Uptime,
};
use crate::{
    config::Settings,
    connections::{self, Connections, FleetConnector, LinkEnds, Snapshot},
    doctor,
    reply::reply,
    version,
};

/// A running registry. It answers queries until its session is closed, and publishes changes until it is dropped.
pub struct Registry {
    _presence: Arc<Presence>,
    /// The only strong reference to the sender: dropping it ends the publishing thread.
    _changed: Arc<mpsc::Sender<Change>>,
}

/// Traffic of a link below Zenoh since it was opened, and its round-trip time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LinkTraffic {
    sent: Traffic,
    received: Traffic,
    round_trip_ms: Option<f64>,
}

/// The sources of the registry's documents.
struct Sources {
    /// The session that answers queries.
    session: Session,
    /// The session of a host router in the same process, whose links are reported too.
    host: Option<Session>,
    connections: Option<Arc<Connections>>,
    presence: Arc<Presence>,
    uptime: Arc<Uptime>,
    silence: Silence,
    /// Hash of the fleet's name, as advertised.
    fleet_hash: u16,
}

/// Returns the document of a robot in range, with the reason if it has asked for a link and got none.
fn discovered(address: &str, refused: Option<&RefusedStatus>) -> Connection {
    Connection {
        failed: refused.map(|refused| refused.count),
        last_error: refused.map(|refused| Failure {
            what: humanize::short_reason(&refused.reason),
            ago_s: refused.ago_s,
        }),
        ..Connection::of(BLE, address, State::Discovered)
    }
}

/// Returns the alerts of the robot.
pub type Alerts = Box<dyn Fn() -> Vec<RobotAlert> + Send + Sync>;

impl Registry {
    /// Declares the registry of the robot of `settings` and starts its publishing thread.
    ///
    /// `session` answers, and its links and those of `host` are reported. `own` is the prefix of the keys,
    /// `<fleet>/<robot>/@rect`.
    ///
    /// # Errors
    /// Fails if a queryable, subscriber or token cannot be declared, or if the thread cannot be started.
    pub fn serve(
        session: &Session,
        host: Option<Session>,
        own: &str,
        settings: &Settings,
        connections: Option<Arc<Connections>>,
        fleet: Arc<FleetConnector>,
        alerts: Alerts,
    ) -> zenoh::Result<Self> {
        let (changed, changes) = mpsc::channel();
        let changed = Arc::new(changed);
        let on_robots = on_change(&changed, Change::Robots);
        let on_change = on_change(&changed, Change::Links);
        let of_paths = Arc::downgrade(&changed);
        observers::observe(move || notify(&of_paths, Change::Links));
        let presence = Presence::start(session, &settings.fleet, &settings.robot, on_robots)?;
        let uptime = Uptime::start([session].into_iter().chain(&host), &on_change)?;
        if let Some(connections) = &connections {
            connections.on_change(on_change);
        }
        let sources = Arc::new(Sources {
            session: session.clone(),
            host,
            connections,
            presence: Arc::clone(&presence),
            uptime,
            silence: Silence::default(),
            fleet_hash: Advertisement::hash_of_fleet(&settings.fleet),
        });
        sources.answer(own, "connections", |connections, _| connections)?;
        sources.answer(own, "connections/count", |connections, _| {
            Counts::of(&connections)
        })?;
        sources.answer(own, "peers", |connections, selector| {
            let mut peers = peers(connections);
            peers.retain(|peer| selector.matches_peer(peer.connections.len()));
            peers
        })?;
        let (id, start) = (session.zid().to_string(), Instant::now());
        let others = Arc::clone(&presence);
        let adapters = settings.adapters.clone();
        sources.answer(own, "status", move |connections, _| {
            let rule = fleet.rule();
            Status {
                id: id.clone(),
                version: version::SHORT,
                up_s: start.elapsed().as_secs_f64(),
                auto_connect: rule.auto_connect,
                auto_links: rule.auto_links,
                same_name: others.name_conflicts(),
                chooses_intervals: management::is_permitted(),
                adapters: adapters.clone(),
                delayed_declarations: delayed_declarations(),
                connections: Counts::of(&connections),
                alerts: alerts().iter().map(RobotAlert::to_json).collect(),
            }
        })?;
        let adapters = settings.adapters.clone();
        sources.answer(own, "doctor", move |connections, _| {
            doctor::of_router(
                &connections,
                &adapters,
                management::is_permitted(),
                delayed_declarations(),
            )
        })?;
        sources.answer(own, "clock", |_, _| Clock { unix_s: now_s() })?;
        let key = format!("{own}/connections");
        thread::Builder::new()
            .name("registry".to_owned())
            .spawn(move || publish(&sources, &key, &changes))?;
        Ok(Self {
            _presence: presence,
            _changed: changed,
        })
    }
}

impl Sources {
    /// Declares a queryable for the document `name` below the prefix `own`. `make` returns the document for the connections
    /// that match a query.
    fn answer<T: Serialize>(
        self: &Arc<Self>,
        own: &str,
        name: &str,
        make: impl Fn(Vec<Connection>, &Selector) -> T + Send + Sync + 'static,
    ) -> zenoh::Result<()> {
        let (sources, key) = (Arc::clone(self), format!("{own}/{name}"));
        let key_of_answer = key.clone();
        let on_query = move |query: Query| {
            let made = Selector::parse(query.parameters().iter()).map(|selector| {
                let mut connections = sources.connections(&Sockets::open());
                connections.retain(|connection| selector.matches(connection));
                make(connections, &selector)
            });
            reply(&query, &key_of_answer, made);
        };
        let queryable = self.session.declare_queryable(key).callback(on_query);
        queryable.background().wait()
    }

    /// Returns all links except those between this robot's own routers.
    fn links(&self) -> Vec<Link> {
        let sessions = || [&self.session].into_iter().chain(&self.host);
        let own: Vec<_> = sessions().map(Session::zid).collect();
        let mut links = Vec::new();
        for session in sessions() {
            let of_others = |link: &Link| !own.contains(link.zid());
            links.extend(session.info().links().wait().filter(of_others));
        }
        links
    }

    /// Returns whether there is a link to a router, opened less than `max_age` ago, whose robot is not known yet.
    fn awaits_names(&self, max_age: Duration) -> bool {
        let sessions = [&self.session].into_iter().chain(&self.host);
        let routers: Vec<_> = sessions
            .flat_map(|session| session.info().routers_zid().wait())
            .collect();
        let is_new = |link: &Link| {
            let up = self.uptime.of(&LinkEnds::of(link.src(), link.dst()));
            up.is_none_or(|up| up < max_age)
        };
        self.links().iter().any(|link| {
            routers.contains(link.zid())
                && is_new(link)
                && self.presence.robot_of(&link.zid().to_string()).is_none()
        })
    }

    /// Returns the remote locator of a link to the router with identifier `id`, if there is one.
    fn link_to(&self, id: &str) -> Option<String> {
        let links = self.links();
        let link = links.iter().find(|link| link.zid().to_string() == id)?;
        Some(link.dst().to_string())
    }

    /// Returns all connections: the named ones sorted by name, then the other links, then discovered robots.
    fn connections(&self, sockets: &Sockets) -> Vec<Connection> {
        let links = self.links();
        let mut by_ends: HashMap<_, _> = links
            .iter()
            .map(|link| (LinkEnds::of(link.src(), link.dst()), link))
            .collect();
        let radio = Radio::now();
        let carried = |link: &Link| radio.carried(link).or_else(|| sockets.carried(link));
        self.silence
            .retain(&by_ends.keys().cloned().collect::<HashSet<_>>());
        let mut connections = Vec::new();
        let named = self.connections.as_ref();
        for snapshot in named.map_or_else(Vec::new, |named| named.snapshots()) {
            let mut link = None;
            for ends in &snapshot.ends {
                link = by_ends.remove(ends).or(link);
            }
            // Two robots have one Bluetooth link at most, which may have been dialled by the other one.
            let by_peer =
                |(_, link): &(&LinkEnds, &&Link)| radio.leads_to(link, &snapshot.spec.endpoint);
            if let (None, Some(ends)) = (link, by_ends.iter().find(by_peer).map(|(e, _)| e.clone()))
            {
                link = by_ends.remove(&ends);
            }
            let carried = link.and_then(carried);
            connections.push(self.named(snapshot, link, carried, &radio));
        }
        let mut others: Vec<_> = by_ends
            .into_values()
            .map(|link| self.other(link, carried(link), &radio))
            .collect();
        others.sort_by(|a, b| (&a.method, &a.address).cmp(&(&b.method, &b.address)));
        connections.extend(others);
        let discovered = self.discovered(&radio, &connections);
        connections.extend(discovered);
        connections
    }

    /// Returns the discovered robots of the fleet to which there is neither a connection nor a link.
    fn discovered(&self, radio: &Radio, connections: &[Connection]) -> Vec<Connection> {
        let has_connection = |robot: &DiscoveredStatus| {
            let leads_to_robot = |connection: &Connection| {
                let address = &connection.address;
                let is_same = *address == robot.address || Some(address) == robot.name.as_ref();
                has_radio(&connection.method) && is_same
            };
            connections.iter().any(leads_to_robot)
        };
        let is_linked =
            |robot: &DiscoveredStatus| radio.links.iter().any(|link| link.address == robot.address);
        let of_fleet = (radio.discovered.iter()).filter(|r| r.fleet_hash == self.fleet_hash);
        let free = of_fleet.filter(|robot| !is_linked(robot) && !has_connection(robot));
        let found = free.map(|robot| {
            let address = robot.name.as_ref().unwrap_or(&robot.address);
            let refused = radio.refused.iter();
            let mut refused = refused.filter(|refused| refused.address == robot.address);
            Connection {
                rssi_dbm: robot.rssi_dbm,
                ..discovered(address, refused.next())
            }
        });
        // This robot scans only while it dials, but a robot that asks for a link is in range.
        let has_row = |refused: &&RefusedStatus| {
            let same = |address: &String| *address == refused.address;
            radio.discovered.iter().any(|robot| same(&robot.address))
                || radio.links.iter().any(|link| same(&link.address))
                || connections
                    .iter()
                    .any(|connection| same(&connection.address))
        };
        let others = radio.refused.iter().filter(|refused| !has_row(refused));
        let others = others.map(|refused| discovered(&refused.address, Some(refused)));
        found.chain(others).collect()
    }

    /// Returns the document of a named connection, given its link if it has one.
    fn named(
        &self,
        snapshot: Snapshot,
        link: Option<&Link>,
        carried: Option<LinkTraffic>,
        radio: &Radio,
    ) -> Connection {
        let failure = |error: connections::LastError| Failure {
            what: humanize::short_reason(&error.reason),
            ago_s: SystemTime::now()
                .duration_since(error.at)
                .map_or(0.0, |ago| ago.as_secs_f64()),
        };
        let ble = link.and_then(|link| radio.link(link));
        let address = snapshot.spec.endpoint.address().as_str().to_owned();
        // The traffic of a link that the peer dialled is counted by the radio only.
        let of_peer = carried.filter(|_| snapshot.ends.is_empty());
        let advertiser = ble.map_or(&address, |ble| &ble.address);
        let has_radio = has_radio(&snapshot.spec.method);
        let rssi_dbm = has_radio.then(|| radio.rssi_dbm(advertiser)).flatten();
        Connection {
            name: Some(snapshot.spec.name),
            method: snapshot.spec.method,
            rssi_dbm,
            encrypted: link.and_then(|link| is_encrypted(link, radio)),
            silent_s: link.and_then(|link| self.silent_s(link, radio)),
            address,
            state: link.map_or(State::Connecting, |_| State::Connected),
            peer: link.map(|link| self.peer(link)),
            up_s: match (link, snapshot.since) {
                (None, _) => None,
                (_, Some(since)) => Some(since.elapsed().as_secs_f64()),
                (Some(link), None) => self.up_s(link),
            },
            sent: Some(of_peer.map_or(snapshot.sent, |carried| snapshot.sent + carried.sent)),
            received: Some(of_peer.map_or(snapshot.received, |c| snapshot.received + c.received)),
            round_trip_ms: carried.and_then(|carried| carried.round_trip_ms),
            paths: link.and_then(|link| radio.paths(link)),
            switches: link.and_then(|link| radio.switches(link)),
            last_switch: link.and_then(|link| radio.last_switch(link)),
            lanes: link.and_then(|link| radio.lanes(link)),
            linked: Some(snapshot.linked),
            failed: Some(snapshot.failed),
            last_error: snapshot.last_error.map(failure),
        }
    }

    /// Returns the document of a link that belongs to no named connection.
    fn other(&self, link: &Link, carried: Option<LinkTraffic>, radio: &Radio) -> Connection {
        let ble = radio.link(link);
        let (method, address) = (link.dst().protocol(), link.dst().address());
        Connection {
            rssi_dbm: ble.and_then(|ble| radio.rssi_dbm(&ble.address)),
            encrypted: is_encrypted(link, radio),
            silent_s: self.silent_s(link, radio),
            peer: Some(self.peer(link)),
            up_s: self.up_s(link),
            sent: carried.map(|carried| carried.sent),
            received: carried.map(|carried| carried.received),
            round_trip_ms: carried.and_then(|carried| carried.round_trip_ms),
            paths: radio.paths(link),
            switches: radio.switches(link),
            last_switch: radio.last_switch(link),
            lanes: radio.lanes(link),
            ..Connection::of(method.as_str(), address.as_str(), State::Connected)
        }
    }

    /// Returns the time in seconds for which a link over Bluetooth, or over several paths, has been silent; `None` if it is not. Other
    /// links are closed by the system.
    fn silent_s(&self, link: &Link, radio: &Radio) -> Option<f64> {
        let received = radio.carried(link)?.received.bytes;
        let ends = LinkEnds::of(link.src(), link.dst());
        let silent = self.silence.of(ends, received, Instant::now())?;
        Some(silent.as_secs_f64())
    }

    /// Returns the time in seconds for which a link has been open.
    fn up_s(&self, link: &Link) -> Option<f64> {
        let up = self.uptime.of(&LinkEnds::of(link.src(), link.dst()))?;
        Some(up.as_secs_f64())
    }

    /// Returns the identifier and, if it is known, the robot of the router at the other end of a link.
    fn peer(&self, link: &Link) -> PeerId {
        let id = link.zid().to_string();
        let robot = self.presence.robot_of(&id);
        PeerId { id, robot }
    }
}

/// Returns whether a link is encrypted, or `None` if it does not leave the computer or its method is not known.
fn is_encrypted(link: &Link, radio: &Radio) -> Option<bool> {
    if let Some(is_encrypted) = radio.is_encrypted(link) {
        return Some(is_encrypted);
    }
    let address = link.dst().address().as_str().parse::<SocketAddr>();
    let is_local = address.is_ok_and(|address| address.ip().is_loopback());
    match link.dst().protocol().as_str() {
        "tls" | "quic" | "wss" => Some(true),
        "tcp" | "udp" | "ws" if !is_local => Some(false),
        _ => None,
    }
}

/// Returns a function that notifies the publishing thread of a change, if it still runs.
fn on_change(
    changed: &Arc<mpsc::Sender<Change>>,
    change: Change,
) -> impl Fn() + Clone + Send + Sync + 'static {
    let changed = Arc::downgrade(changed);
    move || {
        notify(&changed, change);
    }
}

/// Notifies the publishing thread of a change. Returns whether it still runs.
fn notify(changed: &Weak<mpsc::Sender<Change>>, change: Change) -> bool {
    let changed = changed.upgrade();
    changed.is_some_and(|changed| changed.send(change).is_ok())
}

/// Returns the time in seconds since 1970-01-01 UTC.
pub fn now_s() -> f64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0.0, |now| now.as_secs_f64())
}
