//! Owns connections as a router's registry tells of them (docs/registry.md; the router writes these), and what is news
//! among them.
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::name::Name;

/// Whether a connection carries messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ConnectionState {
    /// It does.
    Connected,
    /// It is wanted, and dialled until it does.
    Connecting,
    /// A robot of the fleet is heard by Bluetooth, and not linked.
    Discovered,
}

impl ConnectionState {
    /// By its name.
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
    /// As the file of connections names it, if it does.
    pub name: Option<String>,
    /// `ble`, `tcp`, `udp`, ...
    pub method: String,
    /// Whom or where, without the method.
    pub address: String,
    /// Whether it carries messages.
    pub state: ConnectionState,
    /// Who is at the other end, once that is known.
    pub peer: Option<PeerId>,
    /// For how long it has been there, in seconds.
    pub up_s: Option<f64>,
    /// What went out, where it is counted.
    pub sent: Option<Traffic>,
    /// What came, where it is counted.
    pub received: Option<Traffic>,
    /// There and back, in milliseconds, where it is measured.
    pub round_trip_ms: Option<f64>,
    /// How strong its signal is, in dBm, where it was heard within a minute.
    pub rssi_dbm: Option<i16>,
    /// How often it was made.
    pub linked: Option<u64>,
    /// Attempts that came to nothing since then.
    pub failed: Option<u64>,
    /// What went wrong last.
    pub last_error: Option<Trouble>,
}

impl Connection {
    /// One of which no more is known.
    pub fn of(method: &str, address: &str, state: ConnectionState) -> Self {
        Self {
            name: None,
            method: method.to_owned(),
            address: address.to_owned(),
            state,
            peer: None,
            up_s: None,
            sent: None,
            received: None,
            round_trip_ms: None,
            rssi_dbm: None,
            linked: None,
            failed: None,
            last_error: None,
        }
    }
}

/// Somebody at the other end.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PeerId {
    /// Zenoh's id of its router or program.
    pub id: String,
    /// The robot, where it is one of RECT.
    pub robot: Option<String>,
}

/// What went one way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Traffic {
    /// Batches of Zenoh: one or more messages each, or a part of one. `None`: only bytes are counted.
    pub batches: Option<u64>,
    /// Their bytes.
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

/// What went wrong.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trouble {
    /// In words.
    pub what: String,
    /// How long ago, in seconds.
    pub ago_s: f64,
}

/// Something has changed about who can be reached.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Event {
    /// A robot of the fleet is there.
    PeerUp {
        /// Which.
        robot: Name,
    },
    /// It is gone, or cannot be reached any more.
    PeerDown {
        /// Which.
        robot: Name,
    },
    /// This robot has a link more. It comes again, with the robot, if the link turns out to lead to one later on.
    LinkUp(Link),
    /// It has one less.
    LinkDown(Link),
    /// This program has its router (again).
    RouterUp,
    /// This program has lost its router. Zenoh looks for it by itself.
    RouterDown,
}

/// A link of this robot's router; without a router, of this program.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Link {
    /// Over which radio or wire: `ble`, `tcp`, `udp`, ...
    pub method: String,
    /// Where it leads.
    pub address: String,
    /// To which robot, where that is known.
    pub robot: Option<Name>,
}

/// The links there are, to tell what is news.
#[derive(Debug, Default)]
pub struct Links {
    /// By method and address: the robot at the other end, once that is known.
    links: BTreeMap<(String, String), Option<Name>>,
}

impl Links {
    /// Returns what has changed, given all connections as they are now. Which robot a link leads to is known a moment after
    /// the link, and forgotten a moment before its end: neither is a link less.
    pub fn on_connections(&mut self, connections: &[Connection]) -> Vec<Event> {
        let mut now: BTreeMap<_, Option<Name>> = BTreeMap::new();
        let connected = |one: &&Connection| one.state == ConnectionState::Connected;
        for Link {
            method,
            address,
            robot,
        } in connections.iter().filter(connected).map(Link::of)
        {
            let known = now.entry((method, address)).or_default();
            *known = known.take().or(robot);
        }
        let before = std::mem::take(&mut self.links);
        let (mut gone, mut new) = (Vec::new(), Vec::new());
        for (ends, robot) in &mut now {
            match (before.get(ends), robot.as_ref()) {
                (Some(before), None) => robot.clone_from(before),
                (Some(Some(before)), Some(robot)) if before == robot => {}
                (Some(Some(before)), Some(_)) => {
                    gone.push(Event::LinkDown(Link::between(ends, Some(before))));
                    new.push(Event::LinkUp(Link::between(ends, robot.as_ref())));
                }
                (Some(None) | None, _) => {
                    new.push(Event::LinkUp(Link::between(ends, robot.as_ref())));
                }
            }
        }
        for (ends, robot) in before.iter().filter(|(ends, _)| !now.contains_key(*ends)) {
            gone.push(Event::LinkDown(Link::between(ends, robot.as_ref())));
        }
        self.links = now;
        gone.append(&mut new);
        gone
    }

    /// By what a robot is linked with this one; `None`: not at all, or by several methods.
    pub fn method(&self, robot: &Name) -> Option<&str> {
        let its = self
            .links
            .iter()
            .filter(|(_, to)| to.as_ref() == Some(robot));
        let mut methods = its.map(|((method, _), _)| method.as_str());
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

/// The robots there are, by what says that they are: a robot is there as long as one of its routers or programs is.
#[derive(Debug, Default)]
pub struct Presence {
    there: BTreeMap<Name, std::collections::BTreeSet<String>>,
}

impl Presence {
    /// One of a robot's has come.
    pub fn on_up(&mut self, robot: &Name, id: &str) -> Option<Event> {
        let ids = self.there.entry(robot.clone()).or_default();
        let first = ids.is_empty();
        ids.insert(id.to_owned());
        let robot = robot.clone();
        first.then_some(Event::PeerUp { robot })
    }

    /// One of a robot's is gone.
    pub fn on_down(&mut self, robot: &Name, id: &str) -> Option<Event> {
        let ids = self.there.get_mut(robot)?;
        ids.remove(id);
        if !ids.is_empty() {
            return None;
        }
        self.there.remove(robot);
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
    fn what_is_new_and_what_is_gone_is_news_once() {
        use ConnectionState::{Connected, Connecting};
        let mut links = Links::default();
        let both = [
            connection("ble", "b", Connected),
            connection("tcp", "c", Connected),
            connection("tcp", "d", Connecting),
        ];
        assert_eq!(links.on_connections(&both).len(), 2);
        assert_eq!(links.on_connections(&both), []);
        let b = Name::new("b").expect("a name");
        assert_eq!(links.method(&b), Some("ble"));
        let more = [both[0].clone(), connection("tcp", "b", Connected)];
        let news = links.on_connections(&more);
        assert!(
            matches!(&news[0], Event::LinkDown(link) if link.address == "to-c"),
            "{news:?}"
        );
        assert!(
            matches!(&news[1], Event::LinkUp(link) if link.method == "tcp"),
            "{news:?}"
        );
        assert_eq!(links.method(&b), None, "by two methods");
    }

    #[test]
    fn a_link_whose_robot_becomes_known_later_is_not_lost() {
        use ConnectionState::Connected;
        let named = connection("ble", "b", Connected);
        let unnamed = Connection {
            peer: None,
            ..named.clone()
        };
        let link = |robot: Option<&str>| Link {
            method: "ble".to_owned(),
            address: "to-b".to_owned(),
            robot: robot.map(|robot| Name::new(robot).expect("a name")),
        };
        let mut links = Links::default();
        // A reconnect, again and again: the link, its robot, its robot forgotten, its end.
        for _ in 0..2 {
            let news = links.on_connections(std::slice::from_ref(&unnamed));
            assert_eq!(news, [Event::LinkUp(link(None))]);
            let news = links.on_connections(std::slice::from_ref(&named));
            assert_eq!(news, [Event::LinkUp(link(Some("b")))]);
            assert_eq!(links.on_connections(std::slice::from_ref(&unnamed)), []);
            let b = Name::new("b").expect("a name");
            assert_eq!(links.method(&b), Some("ble"));
            let news = links.on_connections(&[]);
            assert_eq!(news, [Event::LinkDown(link(Some("b")))]);
        }
    }

    #[test]
    fn another_robot_at_the_same_address_is_another_link() {
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
        let news = links.on_connections(&[second]);
        assert!(
            matches!(&news[..], [Event::LinkDown(_), Event::LinkUp(_)]),
            "{news:?}"
        );
    }

    #[test]
    fn a_robot_is_there_as_long_as_one_of_its_own_is() {
        let b = Name::new("b").expect("a name");
        let mut presence = Presence::default();
        assert!(presence.on_down(&b, "1").is_none());
        assert!(presence.on_up(&b, "1").is_some());
        assert!(presence.on_up(&b, "2").is_none());
        assert!(presence.on_down(&b, "1").is_none());
        assert!(presence.on_down(&b, "2").is_some());
    }
}
