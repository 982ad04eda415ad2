//! Defines connections as a router's registry reports them (docs/reference/registry.md), and derives events from their changes.
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::name::Name;

/// The state of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ConnectionState {
    /// The connection has a link and carries messages.
    Connected,
    /// The router is dialling the peer.
    Connecting,
    /// A robot of the fleet whose Bluetooth advertisement was received, and to which there is no link.
    Discovered,
}

impl ConnectionState {
    /// Parses the name of a state, such as `connected`. Returns `None` if there is no such state.
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "connected" => Some(Self::Connected),
            "connecting" => Some(Self::Connecting),
            "discovered" => Some(Self::Discovered),
            _ => None,
        }
    }
}

/// A connection of a robot's router.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Connection {
    /// Name in the connections file, if it has one.
    pub name: Option<String>,
    /// Method of the link: `any`, `ble`, `tcp`, `udp` and so on.
    pub method: String,
    /// Address of the peer, without the method.
    pub address: String,
    /// State of the connection.
    pub state: ConnectionState,
    /// The peer, once it is known.
    pub peer: Option<PeerId>,
    /// How long the link has been up, in seconds.
    pub up_s: Option<f64>,
    /// How long nothing has been received over the link, in seconds, if that is longer than usual: an idle link receives something every
    /// 2.5 s. Only for the methods `any` and `ble`.
    #[serde(default)]
    pub silent_s: Option<f64>,
    /// Sent traffic, if it is counted.
    pub sent: Option<Traffic>,
    /// Received traffic, if it is counted.
    pub received: Option<Traffic>,
    /// Round trip in milliseconds, if it is measured.
    pub round_trip_ms: Option<f64>,
    /// Signal strength in dBm, if an advertisement was received within the last minute.
    pub rssi_dbm: Option<i16>,
    /// Whether the link is encrypted, if that is known.
    pub encrypted: Option<bool>,
    /// The paths of the link, if its method is `any`.
    #[serde(default)]
    pub paths: Option<Vec<LinkPath>>,
    /// How often the path that carries the bulk was replaced, if the method is `any`: by another one, or by itself after it had
    /// been silent.
    #[serde(default)]
    pub switches: Option<u64>,
    /// The last time it was.
    #[serde(default)]
    pub last_switch: Option<PathSwitch>,
    /// The lanes of the link that were used, the most urgent first, if its method is `any` or `ble`.
    #[serde(default)]
    pub lanes: Option<Vec<LinkLane>>,
    /// How often the connection was established.
    pub linked: Option<u64>,
    /// Attempts that have failed since it was last established.
    pub failed: Option<u64>,
    /// The last failure.
    pub last_error: Option<Failure>,
}

impl Connection {
    /// Creates a connection of which nothing else is known.
    pub fn of(method: &str, address: &str, state: ConnectionState) -> Self {
        Self {
            name: None,
            method: method.to_owned(),
            address: address.to_owned(),
            state,
            peer: None,
            up_s: None,
            silent_s: None,
            sent: None,
            received: None,
            round_trip_ms: None,
            rssi_dbm: None,
            encrypted: None,
            paths: None,
            switches: None,
            last_switch: None,
            lanes: None,
            linked: None,
            failed: None,
            last_error: None,
        }
    }

    /// Returns the name of the robot at the other end, if it is known.
    pub fn robot(&self) -> Option<&str> {
        self.peer.as_ref()?.robot.as_deref()
    }

    /// Returns how many bytes wait to be sent, if it is known.
    pub fn waiting_bytes(&self) -> Option<u64> {
        let lanes = self.lanes.as_ref()?;
        Some(lanes.iter().map(|lane| lane.waiting_bytes).sum())
    }

    /// Returns the number of batches that the link did not carry because their message was dropped, if it is known.
    pub fn dropped_batches(&self) -> Option<u64> {
        let lanes = self.lanes.as_ref()?;
        Some(lanes.iter().map(|lane| lane.dropped_batches).sum())
    }

    /// Returns how long an urgent message takes until the peer has acknowledged it, in milliseconds, if it was measured.
    pub fn urgent_delay_ms(&self) -> Option<f64> {
        let lanes = self.lanes.iter().flatten();
        let urgent = lanes.filter(|lane| URGENT.contains(&lane.priority.as_str()));
        urgent.filter_map(|lane| lane.delay_ms).next_back()
    }
}

/// Zenoh's priorities that are at least as urgent as an urgent message, and are used for messages. Zenoh's own messages (`Control`) are
/// acknowledged late while nothing else is sent, and say nothing about messages of programs.
const URGENT: [&str; 2] = ["RealTime", "InteractiveHigh"];

/// The sending side of a link for one of Zenoh's priorities.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinkLane {
    /// Zenoh's priority, such as `Data`.
    pub priority: String,
    /// Bytes that wait to be sent.
    pub waiting_bytes: u64,
    /// Moving average of the time until the peer has acknowledged a batch, in milliseconds, if it was measured. It includes the
    /// time for which the batch has waited.
    pub delay_ms: Option<f64>,
    /// Batches that were withdrawn, because Zenoh dropped their message while a part of it waited.
    pub dropped_batches: u64,
}

/// A path of a link whose method is `any`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinkPath {
    /// Method of the path: `ble` or `tcp`.
    pub method: String,
    /// Whether the path is used.
    pub state: LinkPathState,
    /// Whether it carries the bulk. Urgent messages travel on every live path.
    pub is_primary: bool,
    /// Mean round trip in milliseconds, if it was measured.
    pub round_trip_ms: Option<f64>,
    /// Rate in bytes per second: measured, or assumed until then.
    pub bytes_per_s: f64,
    /// Bytes sent over this path.
    pub sent_bytes: u64,
    /// Those of them that another path had carried before, because it was suspected, or because they are urgent.
    pub resent_bytes: u64,
}

/// Whether a path is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LinkPathState {
    /// It has not answered yet.
    Untried,
    /// It is used.
    Live,
    /// Its acknowledgements are missing.
    Suspected,
}

/// A change of the path that carries the bulk of a link.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PathSwitch {
    /// Method of the path before: `ble` or `tcp`.
    pub previous: String,
    /// Method of the path that carries the bulk since then.
    pub path: String,
    /// Why it has changed.
    pub reason: SwitchReason,
    /// How long data had waited for an acknowledgement when another path took it over, in milliseconds.
    pub gap_ms: f64,
    /// Age of the change, in seconds.
    pub ago_s: f64,
}

/// Why another path carries the bulk of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SwitchReason {
    /// The path before has ended: its connection was closed, or its network was lost.
    Ended,
    /// The acknowledgements of the path before were missing.
    Silent,
    /// The other path is faster.
    Faster,
}

impl SwitchReason {
    /// Returns the name of the reason, such as `silent`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Ended => "ended",
            Self::Silent => "silent",
            Self::Faster => "faster",
        }
    }
}

/// The router or program at the other end of a connection.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PeerId {
    /// Zenoh id of the router or program.
    pub id: String,
    /// Name of the robot, if the peer uses RECT.
    pub robot: Option<String>,
}

/// Traffic in one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Traffic {
    /// Zenoh batches: one or more messages each, or a fragment of one. `None` if only bytes are counted.
    pub batches: Option<u64>,
    /// Bytes of these batches.
    pub bytes: u64,
}

impl Default for Traffic {
    fn default() -> Self {
        Self {
            batches: Some(0),
            bytes: 0,
        }
    }
}

impl std::ops::Add for Traffic {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            batches: self.batches.zip(other.batches).map(|(a, b)| a + b),
            bytes: self.bytes + other.bytes,
        }
    }
}

/// A failure of a connection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// Description of the failure.
    pub what: String,
    /// Age of the failure, in seconds.
    pub ago_s: f64,
}

/// A change of the links, the reachable robots, or the router.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Event {
    /// A robot of the fleet can be reached.
    PeerUp {
        /// The robot.
        robot: Name,
    },
    /// A robot of the fleet cannot be reached any more.
    PeerDown {
        /// The robot.
        robot: Name,
    },
    /// A program that has a name is known at a robot of the fleet.
    ProgramUp {
        /// The robot.
        robot: Name,
        /// The program.
        program: Name,
    },
    /// A program has ended, or its robot cannot be reached any more.
    ProgramDown {
        /// The robot.
        robot: Name,
        /// The program.
        program: Name,
    },
    /// This robot has a new link. The event is repeated, with the robot, when it becomes known which robot the link
    /// leads to.
    LinkUp(Link),
    /// A link of this robot has ended.
    LinkDown(Link),
    /// Nothing has been received over a link of this robot for longer than usual. It may end, or [resume](Self::LinkResumed).
    LinkSilent(Link),
    /// Something has been received over a link that was silent.
    LinkResumed(Link),
    /// Another path carries the bulk of a link whose method is `any`.
    PathSwitched {
        /// The link.
        link: Link,
        /// Method of the path that carries the bulk now: `ble` or `tcp`.
        path: String,
        /// Why it has changed.
        reason: SwitchReason,
    },
    /// The program has connected to its router, or reconnected.
    RouterUp,
    /// The program has lost its router. Zenoh reconnects by itself.
    RouterDown,
}

/// A link of this robot's router or, without a router, of this program.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Link {
    /// Method of the link: `ble`, `tcp`, `udp` and so on.
    pub method: String,
    /// Address of the peer.
    pub address: String,
    /// Name of the peer's robot, if it is known.
    pub robot: Option<Name>,
}

/// Keeps track of the current links, to report changes as events.
#[derive(Debug, Default)]
pub struct Links {
    /// By method and address.
    links: BTreeMap<(String, String), KnownLink>,
}

/// A link, as it was last reported.
#[derive(Debug, Default)]
struct KnownLink {
    /// The robot at the other end, if it is known.
    robot: Option<Name>,
    /// How often the path that carries the bulk was replaced.
    switches: u64,
    /// Whether nothing is received over it.
    is_silent: bool,
}

impl Links {
    /// Returns the events since the previous call, given all current connections. The robot of a link becomes known
    /// shortly after the link comes up, and unknown shortly before it ends; neither counts as the end of the link.
    pub fn on_connections(&mut self, connections: &[Connection]) -> Vec<Event> {
        let mut now: BTreeMap<_, KnownLink> = BTreeMap::new();
        let before = std::mem::take(&mut self.links);
        let (mut down, mut up, mut changed) = (Vec::new(), Vec::new(), Vec::new());
        let is_connected = |one: &&Connection| one.state == ConnectionState::Connected;
        for connection in connections.iter().filter(is_connected) {
            let link = Link::of(connection);
            let ends = (link.method, link.address);
            let old = before.get(&ends);
            let state = now.entry(ends.clone()).or_default();
            state.robot = state.robot.take().or(link.robot);
            state.switches = connection.switches.unwrap_or(0);
            state.is_silent = connection.silent_s.is_some();
            if old.is_some_and(|old| old.is_silent) != state.is_silent {
                let robot = state.robot.as_ref();
                let robot = robot.or_else(|| old.and_then(|old| old.robot.as_ref()));
                let link = Link::between(&ends, robot);
                changed.push(match state.is_silent {
                    true => Event::LinkSilent(link),
                    false => Event::LinkResumed(link),
                });
            }
            let Some(switch) = &connection.last_switch else {
                continue;
            };
            if let Some(old) = old.filter(|old| old.switches != state.switches) {
                let robot = state.robot.as_ref().or(old.robot.as_ref());
                changed.push(Event::PathSwitched {
                    link: Link::between(&ends, robot),
                    path: switch.path.clone(),
                    reason: switch.reason,
                });
            }
        }
        for (ends, KnownLink { robot, .. }) in &mut now {
            match (before.get(ends).map(|old| &old.robot), robot.as_ref()) {
                (Some(before), None) => robot.clone_from(before),
                (Some(Some(before)), Some(robot)) if before == robot => {}
                (Some(Some(before)), Some(_)) => {
                    down.push(Event::LinkDown(Link::between(ends, Some(before))));
                    up.push(Event::LinkUp(Link::between(ends, robot.as_ref())));
                }
                (Some(None) | None, _) => {
                    up.push(Event::LinkUp(Link::between(ends, robot.as_ref())));
                }
            }
        }
        for (ends, old) in before.iter().filter(|(ends, _)| !now.contains_key(*ends)) {
            down.push(Event::LinkDown(Link::between(ends, old.robot.as_ref())));
        }
        self.links = now;
        down.into_iter().chain(up).chain(changed).collect()
    }

    /// Returns the method of the links to a robot. `None` if there is no link, or if the links have several methods.
    pub fn method(&self, robot: &Name) -> Option<&str> {
        let to_robot = self
            .links
            .iter()
            .filter(|(_, to)| to.robot.as_ref() == Some(robot));
        let mut methods = to_robot.map(|((method, _), _)| method.as_str());
        let first = methods.next()?;
        methods.all(|method| method == first).then_some(first)
    }
}

impl Link {
    fn between((method, address): &(String, String), robot: Option<&Name>) -> Self {
        Self {
            method: method.clone(),
            address: address.clone(),
            robot: robot.cloned(),
        }
    }

    fn of(connection: &Connection) -> Self {
        let robot = connection
            .peer
            .as_ref()
            .and_then(|peer| peer.robot.as_ref());
        Self {
            method: connection.method.clone(),
            address: connection.address.clone(),
            robot: robot.and_then(|robot| Name::new(robot).ok()),
        }
    }
}

/// Keeps track of the reachable robots. A robot is reachable while at least one of its routers or programs is.
#[derive(Debug, Default)]
pub struct Presence {
    present: BTreeMap<Name, std::collections::BTreeSet<String>>,
}

impl Presence {
    /// Handles a new router or program of a robot, identified by `id`. Returns an event if the robot was not reachable
    /// before.
    pub fn on_up(&mut self, robot: &Name, id: &str) -> Option<Event> {
        let ids = self.present.entry(robot.clone()).or_default();
        let first = ids.is_empty();
        ids.insert(id.to_owned());
        let robot = robot.clone();
        first.then_some(Event::PeerUp { robot })
    }

    /// Handles the end of a router or program of a robot. Returns an event if it was the last one.
    pub fn on_down(&mut self, robot: &Name, id: &str) -> Option<Event> {
        let ids = self.present.get_mut(robot)?;
        ids.remove(id);
        if !ids.is_empty() {
            return None;
        }
        self.present.remove(robot);
        let robot = robot.clone();
        Some(Event::PeerDown { robot })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn connection(method: &str, robot: &str, state: ConnectionState) -> Connection {
        let (id, robot_name) = ("1".to_owned(), Some(robot.to_owned()));
        Connection {
            peer: Some(PeerId {
                id,
                robot: robot_name,
            }),
            ..Connection::of(method, &format!("to-{robot}"), state)
        }
    }

    #[test]
    fn reports_each_change_of_links_once() {
        use ConnectionState::{Connected, Connecting};
        let mut links = Links::default();
        let both = [
            connection("ble", "b", Connected),
            connection("tcp", "c", Connected),
            connection("tcp", "d", Connecting),
        ];
        assert_eq!(links.on_connections(&both).len(), 2);
        assert_eq!(links.on_connections(&both), []);
        let b = Name::new("b").expect("valid name");
        assert_eq!(links.method(&b), Some("ble"));
        let more = [both[0].clone(), connection("tcp", "b", Connected)];
        let events = links.on_connections(&more);
        assert!(
            matches!(&events[0], Event::LinkDown(link) if link.address == "to-c"),
            "{events:?}"
        );
        assert!(
            matches!(&events[1], Event::LinkUp(link) if link.method == "tcp"),
            "{events:?}"
        );
        assert_eq!(links.method(&b), None, "two methods");
    }

    #[test]
    fn reports_each_switch_of_the_path_of_a_link_once() {
        let after = |switches, path: &str| Connection {
            switches: Some(switches),
            last_switch: (switches > 0).then(|| PathSwitch {
                previous: "ble".to_owned(),
                path: path.to_owned(),
                reason: SwitchReason::Silent,
                gap_ms: 120.0,
                ago_s: 0.1,
            }),
            ..connection("any", "b", ConnectionState::Connected)
        };
        let mut links = Links::default();
        let events = links.on_connections(&[after(1, "tcp")]);
        assert!(
            matches!(&events[..], [Event::LinkUp(_)]),
            "switches from before are none: {events:?}"
        );
        assert_eq!(links.on_connections(&[after(1, "tcp")]), []);
        let events = links.on_connections(&[after(2, "ble")]);
        let [Event::PathSwitched { link, path, reason }] = &events[..] else {
            panic!("one event: {events:?}");
        };
        assert_eq!((path.as_str(), *reason), ("ble", SwitchReason::Silent));
        assert_eq!(link.robot.as_ref().map(Name::as_str), Some("b"));
        let events = links.on_connections(&[after(0, "ble")]);
        assert_eq!(events, [], "another link, which was not switched yet");
    }

    #[test]
    fn a_link_keeps_its_robot_while_that_is_unknown() {
        use ConnectionState::Connected;
        let named = connection("ble", "b", Connected);
        let unnamed = Connection {
            peer: None,
            ..named.clone()
        };
        let link = |robot: Option<&str>| Link {
            method: "ble".to_owned(),
            address: "to-b".to_owned(),
            robot: robot.map(|robot| Name::new(robot).expect("valid name")),
        };
        let mut links = Links::default();
        // Reconnects twice: the link comes up, its robot becomes known and unknown again, the link ends.
        for _ in 0..2 {
            let events = links.on_connections(std::slice::from_ref(&unnamed));
            assert_eq!(events, [Event::LinkUp(link(None))]);
            let events = links.on_connections(std::slice::from_ref(&named));
            assert_eq!(events, [Event::LinkUp(link(Some("b")))]);
            assert_eq!(links.on_connections(std::slice::from_ref(&unnamed)), []);
            let b = Name::new("b").expect("valid name");
            assert_eq!(links.method(&b), Some("ble"));
            let events = links.on_connections(&[]);
            assert_eq!(events, [Event::LinkDown(link(Some("b")))]);
        }
    }

    #[test]
    fn reports_a_new_link_if_the_robot_at_an_address_changes() {
        use ConnectionState::Connected;
        let first = connection("tcp", "b", Connected);
        let second = Connection {
            peer: Some(PeerId {
                id: "2".to_owned(),
                robot: Some("c".to_owned()),
            }),
            ..first.clone()
        };
        let mut links = Links::default();
        assert_eq!(links.on_connections(&[first]).len(), 1);
        let events = links.on_connections(&[second]);
        assert!(
            matches!(&events[..], [Event::LinkDown(_), Event::LinkUp(_)]),
            "{events:?}"
        );
    }

    #[test]
    fn a_link_that_falls_silent_and_resumes_is_reported_once() {
        let link = connection("any", "b", ConnectionState::Connected);
        let silent = |silent_s| Connection {
            silent_s,
            ..link.clone()
        };
        let mut links = Links::default();
        let mut kinds = |silent_s| {
            let events = links.on_connections(&[silent(silent_s)]);
            let kinds = events.iter().map(|event| match event {
                Event::LinkUp(_) => "up",
                Event::LinkSilent(link) if link.robot.is_some() => "silent",
                Event::LinkResumed(link) if link.robot.is_some() => "resumed",
                _ => "another",
            });
            kinds.collect::<Vec<_>>()
        };
        assert_eq!(kinds(None), ["up"]);
        assert_eq!(kinds(Some(3.6)), ["silent"]);
        assert!(kinds(Some(4.6)).is_empty());
        assert_eq!(kinds(None), ["resumed"]);
        assert_eq!(kinds(Some(3.5)), ["silent"]);
        assert!(matches!(
            &links.on_connections(&[])[..],
            [Event::LinkDown(_)]
        ));
    }

    #[test]
    fn an_idle_link_has_no_delay_of_urgent_messages() {
        let lane = |priority: &str, delay_ms| LinkLane {
            priority: priority.to_owned(),
            waiting_bytes: 0,
            delay_ms,
            dropped_batches: 0,
        };
        let delay = |lanes: &[LinkLane]| {
            let mut link = connection("any", "b", ConnectionState::Connected);
            link.lanes = Some(lanes.to_vec());
            link.urgent_delay_ms()
        };
        let control = lane("Control", Some(900.0));
        assert_eq!(delay(std::slice::from_ref(&control)), None);
        assert_eq!(delay(&[control.clone(), lane("Data", Some(20.0))]), None);
        let urgent = lane("InteractiveHigh", Some(12.0));
        assert_eq!(
            delay(&[control, lane("RealTime", None), urgent]),
            Some(12.0)
        );
    }

    #[test]
    fn a_robot_is_reachable_while_one_of_its_programs_is() {
        let b = Name::new("b").expect("valid name");
        let mut presence = Presence::default();
        assert!(presence.on_down(&b, "1").is_none());
        assert!(presence.on_up(&b, "1").is_some());
        assert!(presence.on_up(&b, "2").is_none());
        assert!(presence.on_down(&b, "1").is_none());
        assert!(presence.on_down(&b, "2").is_some());
    }
}
