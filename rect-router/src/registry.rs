//! Owns the registry of a robot: which connections there are, to whom, how many. Zenoh queryables answer, changes are
//! published under the same key, and a liveliness token tells that the robot is there. `docs/registry.md` has the keys.
pub mod document;
mod presence;
mod publisher;
mod radio;
pub mod selector;
mod sockets;
mod uptime;

use std::{
    collections::HashMap,
    sync::{mpsc, Arc},
    thread,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use rect::core::{
    connection::{Connection, ConnectionState as State, PeerId, Traffic, Trouble},
    wording,
};
use serde::Serialize;
use zenoh::{bytes::Encoding, query::Query, session::Link, Session, Wait};
use zenoh_link::ble::{
    advertisement::Advertisement, status::HeardStatus, BLE_LOCATOR_PREFIX as BLE,
};

use self::{
    document::{peers, Clock, Counts, Status},
    presence::Presence,
    publisher::{publish, Change},
    radio::Ble,
    selector::Selector,
    sockets::Sockets,
    uptime::Uptime,
};
use crate::{
    config::Settings,
    connections::{self, Connections, Ends, Fleet, Snapshot},
    version,
};

/// Answers until its session is closed; publishes until it is dropped.
pub struct Registry {
    _presence: Arc<Presence>,
    /// The only one that is held for good: without it the publisher ends.
    _changed: Arc<mpsc::Sender<Change>>,
}

/// What is counted below Zenoh on a link, since that began.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Carried {
    sent: Traffic,
    received: Traffic,
    round_trip_ms: Option<f64>,
}

/// What the answers are made of.
struct Sources {
    /// Answers.
    session: Session,
    /// Of a host that has links too.
    host: Option<Session>,
    connections: Option<Arc<Connections>>,
    presence: Arc<Presence>,
    uptime: Arc<Uptime>,
    /// As it is advertised.
    fleet_hash: u16,
}

impl Registry {
    /// Declares what the settings' robot has to say, about the links of `session`, which answers, and of its `host`.
    pub fn serve(
        session: &Session,
        host: Option<Session>,
        own: &str,
        settings: &Settings,
        connections: Option<Arc<Connections>>,
        fleet: Arc<Fleet>,
    ) -> zenoh::Result<Self> {
        let (changed, changes) = mpsc::channel();
        let changed = Arc::new(changed);
        let on_robots = on_change(&changed, Change::Robots);
        let on_change = on_change(&changed, Change::Links);
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
            fleet_hash: Advertisement::hash_of_fleet(&settings.fleet),
        });
        sources.answer(own, "connections", |connections, _| connections)?;
        sources.answer(own, "connections/count", |connections, _| {
            Counts::of(&connections)
        })?;
        sources.answer(own, "peers", |connections, selector| {
            let mut peers = peers(connections);
            peers.retain(|peer| selector.takes_peer(peer));
            peers
        })?;
        let (id, start) = (session.zid().to_string(), Instant::now());
        let others = Arc::clone(&presence);
        sources.answer(own, "status", move |connections, _| {
            let rule = fleet.rule();
            Status {
                id: id.clone(),
                version: version::SHORT,
                up_s: start.elapsed().as_secs_f64(),
                auto_connect: rule.auto_connect,
                auto_links: rule.auto_links,
                same_name: others.namesakes(),
                connections: Counts::of(&connections),
            }
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
    /// `what`: the key under the robot's own; `make`: the document from the connections asked for.
    fn answer<T: Serialize>(
        self: &Arc<Self>,
        own: &str,
        what: &str,
        make: impl Fn(Vec<Connection>, &Selector) -> T + Send + Sync + 'static,
    ) -> zenoh::Result<()> {
        let (sources, key) = (Arc::clone(self), format!("{own}/{what}"));
        let key_of_answer = key.clone();
        let on_query = move |query: Query| {
            let made = Selector::parse(query.parameters()).and_then(|selector| {
                let mut connections = sources.connections(&Sockets::open());
                connections.retain(|connection| selector.takes(connection));
                serde_json::to_vec(&make(connections, &selector)).map_err(|e| e.to_string())
            });
            let replied = match made {
                Ok(json) => query
                    .reply(&key_of_answer, json)
                    .encoding(Encoding::APPLICATION_JSON)
                    .wait(),
                Err(wrong) => query.reply_err(wrong).encoding(Encoding::TEXT_PLAIN).wait(),
            };
            if let Err(error) = replied {
                tracing::debug!("who asked the registry got no answer: {error}");
            }
        };
        let queryable = self.session.declare_queryable(key).callback(on_query);
        queryable.background().wait()
    }

    /// All links but those between this robot's own routers.
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

    /// Whether a link to a router that is younger than `newest` does not have the name of its robot yet.
    fn awaits_names(&self, newest: Duration) -> bool {
        let sessions = [&self.session].into_iter().chain(&self.host);
        let routers: Vec<_> = sessions
            .flat_map(|session| session.info().routers_zid().wait())
            .collect();
        let is_new = |link: &Link| {
            let up = self.uptime.of(&Ends::of(link.src(), link.dst()));
            up.is_none_or(|up| up < newest)
        };
        self.links().iter().any(|link| {
            routers.contains(link.zid())
                && is_new(link)
                && self.presence.robot_of(&link.zid().to_string()).is_none()
        })
    }

    /// The other end of a link to that router, if there is one.
    fn way_to(&self, id: &str) -> Option<String> {
        let links = self.links();
        let link = links.iter().find(|link| link.zid().to_string() == id)?;
        Some(link.dst().to_string())
    }

    /// All that are wanted, by name, all others that are there, and those that could be.
    fn connections(&self, sockets: &Sockets) -> Vec<Connection> {
        let links = self.links();
        let mut by_ends: HashMap<_, _> = links
            .iter()
            .map(|link| (Ends::of(link.src(), link.dst()), link))
            .collect();
        let ble = Ble::now();
        let carried = |link: &Link| ble.carried(link).or_else(|| sockets.carried(link));
        let mut connections = Vec::new();
        let named = self.connections.as_ref();
        for snapshot in named.map_or_else(Vec::new, |named| named.snapshots()) {
            let mut link = None;
            for ends in &snapshot.ends {
                link = by_ends.remove(ends).or(link);
            }
            // A pair has one link by radio, whoever dialled.
            let by_peer = |(_, link): &(&Ends, &&Link)| ble.leads_to(link, &snapshot.spec.endpoint);
            if let (None, Some(ends)) = (link, by_ends.iter().find(by_peer).map(|(e, _)| e.clone()))
            {
                link = by_ends.remove(&ends);
            }
            let carried = link.and_then(carried);
            connections.push(self.named(snapshot, link, carried, &ble));
        }
        let mut others: Vec<_> = by_ends
            .into_values()
            .map(|link| self.other(link, carried(link), &ble))
            .collect();
        others.sort_by(|a, b| (&a.method, &a.address).cmp(&(&b.method, &b.address)));
        connections.extend(others);
        let discovered = self.discovered(&ble, &connections);
        connections.extend(discovered);
        connections
    }

    /// Robots of the fleet that are heard, and that no connection leads to.
    fn discovered(&self, ble: &Ble, connections: &[Connection]) -> Vec<Connection> {
        let is_wanted = |heard: &HeardStatus| {
            let leads_to_it = |one: &Connection| {
                let is_it =
                    one.address == heard.address || Some(&one.address) == heard.name.as_ref();
                one.method == BLE && is_it
            };
            connections.iter().any(leads_to_it)
        };
        let is_linked =
            |heard: &HeardStatus| ble.links.iter().any(|link| link.address == heard.address);
        let of_fleet = ble.heard.iter().filter(|h| h.fleet_hash == self.fleet_hash);
        let free = of_fleet.filter(|heard| !is_linked(heard) && !is_wanted(heard));
        let discovered = free.map(|heard| {
            let address = heard.name.as_ref().unwrap_or(&heard.address);
            Connection {
                rssi_dbm: heard.rssi_dbm,
                ..Connection::of(BLE, address, State::Discovered)
            }
        });
        discovered.collect()
    }

    fn named(
        &self,
        snapshot: Snapshot,
        link: Option<&Link>,
        carried: Option<Carried>,
        ble: &Ble,
    ) -> Connection {
        let trouble = |trouble: connections::Trouble| Trouble {
            what: wording::short_reason(&trouble.what),
            ago_s: SystemTime::now()
                .duration_since(trouble.at)
                .map_or(0.0, |ago| ago.as_secs_f64()),
        };
        let radio = link.and_then(|link| ble.link(link));
        let address = snapshot.spec.endpoint.address().as_str().to_owned();
        // What the peer dialled is counted by the radio alone.
        let of_peer = carried.filter(|_| snapshot.ends.is_empty());
        let heard_as = radio.map_or(&address, |radio| &radio.address);
        let is_ble = snapshot.spec.method == BLE;
        let rssi_dbm = is_ble.then(|| ble.rssi_dbm(heard_as)).flatten();
        Connection {
            name: Some(snapshot.spec.name),
            method: snapshot.spec.method,
            rssi_dbm,
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
            linked: Some(snapshot.linked),
            failed: Some(snapshot.failed),
            last_error: snapshot.last_error.map(trouble),
        }
    }

    fn other(&self, link: &Link, carried: Option<Carried>, ble: &Ble) -> Connection {
        let radio = ble.link(link);
        let (method, address) = (link.dst().protocol(), link.dst().address());
        Connection {
            rssi_dbm: radio.and_then(|radio| ble.rssi_dbm(&radio.address)),
            peer: Some(self.peer(link)),
            up_s: self.up_s(link),
            sent: carried.map(|carried| carried.sent),
            received: carried.map(|carried| carried.received),
            round_trip_ms: carried.and_then(|carried| carried.round_trip_ms),
            ..Connection::of(method.as_str(), address.as_str(), State::Connected)
        }
    }

    fn up_s(&self, link: &Link) -> Option<f64> {
        let up = self.uptime.of(&Ends::of(link.src(), link.dst()))?;
        Some(up.as_secs_f64())
    }

    fn peer(&self, link: &Link) -> PeerId {
        let id = link.zid().to_string();
        let robot = self.presence.robot_of(&id);
        PeerId { id, robot }
    }
}

/// What tells the publisher of a change, if there still is one.
fn on_change(
    changed: &Arc<mpsc::Sender<Change>>,
    change: Change,
) -> impl Fn() + Clone + Send + Sync + 'static {
    let changed = Arc::downgrade(changed);
    move || {
        if let Some(changed) = changed.upgrade() {
            let _ = changed.send(change);
        }
    }
}

/// Since 1970.
pub fn now_s() -> f64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0.0, |now| now.as_secs_f64())
}
