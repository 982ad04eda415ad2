//! Decides which accepted links may stay; plain logic without I/O.

use std::{
    collections::HashMap,
    fmt,
    net::{IpAddr, Ipv6Addr, SocketAddr},
    time::Duration,
};

use zenoh_protocol::core::Locator;

/// How many links may be accepted at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Unfinished handshakes. One more evicts the oldest of the source that has the most.
    pub handshakes: usize,
    /// Links with a finished handshake, of all sources.
    pub sessions: usize,
    /// Links with a finished handshake, of one source.
    pub sessions_per_source: usize,
    /// How long a handshake may take.
    pub handshake_timeout: Duration,
}

/// Where a link comes from, as far as a peer cannot choose it freely.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Source {
    /// A program on this computer, over loopback or a socket file.
    ThisComputer,
    /// An IPv4 address, or the first 64 bits of an IPv6 address: a computer may choose the others.
    Address(IpAddr),
    /// A link without addresses, by its protocol, such as `serial`.
    Protocol(String),
}

impl Source {
    /// Returns the source of a link whose other end is `peer`.
    pub fn of(peer: &Locator) -> Self {
        let protocol = peer.protocol();
        if let Ok(address) = peer.address().as_str().parse::<SocketAddr>() {
            return Self::of_ip(address.ip());
        }
        match protocol.as_str() {
            "unixsock-stream" | "unixpipe" => Self::ThisComputer,
            other => Self::Protocol(other.to_owned()),
        }
    }

    fn of_ip(ip: IpAddr) -> Self {
        match ip.to_canonical() {
            ip if ip.is_loopback() => Self::ThisComputer,
            ip @ IpAddr::V4(_) => Self::Address(ip),
            IpAddr::V6(ip) => {
                let network = ip.to_bits() >> 64 << 64;
                Self::Address(Ipv6Addr::from_bits(network).into())
            }
        }
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ThisComputer => f.write_str("a program on this computer"),
            Self::Address(ip) => write!(f, "{ip}"),
            Self::Protocol(protocol) => write!(f, "a {protocol} link"),
        }
    }
}

/// Why a link may not stay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Other links of its source began a handshake after it and none was free.
    #[error("too many connections that have not logged in; the oldest is closed for a new one")]
    Handshakes,
    /// Links that were evicted have not closed yet.
    #[error("connections arrive faster than they can be closed")]
    Busy,
    /// All that the router accepts.
    #[error("all {0} sessions for others than Bluetooth links are taken (transport/unicast/max_sessions)")]
    Sessions(usize),
    /// All that one source may have.
    #[error("it has all {0} sessions that one address may have (config/README.md, \"How many may connect\")")]
    SessionsOfSource(usize),
}

/// Names a place; none is used twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PlaceId(u64);

/// A place that was given to a new link.
#[derive(Debug, PartialEq, Eq)]
pub struct Admitted {
    /// The new place.
    pub id: PlaceId,
    /// The link that has to end for it.
    pub evicted: Option<Evicted>,
}

/// A link that lost its place.
#[derive(Debug, PartialEq, Eq)]
pub struct Evicted {
    pub id: PlaceId,
    pub source: Source,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Handshake,
    Established,
    /// Evicted or refused; Zenoh still has it.
    Ending,
}

/// Every accepted link that Zenoh has.
pub struct Places {
    limits: Limits,
    next: u64,
    links: HashMap<PlaceId, (Source, Stage)>,
}

impl Places {
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            next: 0,
            links: HashMap::new(),
        }
    }

    /// Gives a new link a place for its handshake.
    pub fn admit(&mut self, source: &Source) -> Result<Admitted, Refusal> {
        self.has_room(source)?;
        // As many links may be ending as may shake hands: that bounds what a flood can take of Zenoh.
        if self.count(|_, stage| stage == Stage::Ending) >= self.limits.handshakes.max(1) {
            return Err(Refusal::Busy);
        }
        let under_way = self.count(|_, stage| stage == Stage::Handshake);
        let mut evicted = None;
        if under_way >= self.limits.handshakes.max(1) {
            evicted = self.evict(source);
        }
        let id = PlaceId(self.next);
        self.next += 1;
        self.links.insert(id, (source.clone(), Stage::Handshake));
        Ok(Admitted { id, evicted })
    }

    /// Counts a link as a session, now that its handshake is complete.
    pub fn establish(&mut self, id: PlaceId) -> Result<(), Refusal> {
        let Some((source, Stage::Handshake)) = self.links.get(&id).cloned() else {
            // It was evicted at this moment.
            return Err(Refusal::Handshakes);
        };
        let room = self.has_room(&source);
        let stage = match room {
            Ok(()) => Stage::Established,
            Err(_) => Stage::Ending,
        };
        self.links.insert(id, (source, stage));
        room
    }

    /// Gives the place of a link back that Zenoh does not have any more.
    pub fn release(&mut self, id: PlaceId) {
        self.links.remove(&id);
    }

    fn has_room(&self, source: &Source) -> Result<(), Refusal> {
        let Limits {
            sessions,
            sessions_per_source,
            ..
        } = self.limits;
        if self.count(|_, stage| stage == Stage::Established) >= sessions {
            return Err(Refusal::Sessions(sessions));
        }
        let of_source = |of: &Source, stage| of == source && stage == Stage::Established;
        if self.count(of_source) >= sessions_per_source {
            return Err(Refusal::SessionsOfSource(sessions_per_source));
        }
        Ok(())
    }

    fn count(&self, matches: impl Fn(&Source, Stage) -> bool) -> usize {
        let links = self.links.values();
        links.filter(|(of, stage)| matches(of, *stage)).count()
    }

    /// Ends the oldest handshake of the source that has the most of them, `newcomer` counted as one of its source's.
    fn evict(&mut self, newcomer: &Source) -> Option<Evicted> {
        let mut by_source: HashMap<&Source, (usize, PlaceId)> = HashMap::new();
        for (id, (source, stage)) in &self.links {
            if *stage == Stage::Handshake {
                let (count, oldest) = by_source.entry(source).or_insert((0, *id));
                *count += 1;
                *oldest = (*oldest).min(*id);
            }
        }
        if let Some((count, _)) = by_source.get_mut(newcomer) {
            *count += 1;
        }
        // Of two with as many, the one whose oldest has waited longer.
        let (source, (_, id)) = by_source
            .into_iter()
            .max_by_key(|(_, (count, oldest))| (*count, std::cmp::Reverse(*oldest)))?;
        let evicted = Evicted {
            id,
            source: source.clone(),
        };
        self.links
            .insert(id, (evicted.source.clone(), Stage::Ending));
        Some(evicted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        handshakes: 3,
        sessions: 4,
        sessions_per_source: 2,
        handshake_timeout: Duration::from_secs(3),
    };

    fn source(number: u8) -> Source {
        Source::Address(IpAddr::from([10, 0, 0, number]))
    }

    fn admit(places: &mut Places, number: u8) -> Admitted {
        places.admit(&source(number)).expect("a place")
    }

    fn establish(places: &mut Places, number: u8) -> Result<PlaceId, Refusal> {
        let id = places.admit(&source(number))?.id;
        places.establish(id)?;
        Ok(id)
    }

    #[test]
    fn a_flood_of_one_source_evicts_its_own_handshakes() {
        let mut places = Places::new(LIMITS);
        let honest = admit(&mut places, 1);
        let first = admit(&mut places, 2);
        admit(&mut places, 2);
        for _ in 0..20 {
            let evicted = admit(&mut places, 2).evicted.expect("one has to go");
            assert_eq!(evicted.source, source(2));
            places.release(evicted.id);
        }
        assert_eq!(places.establish(honest.id), Ok(()));
        assert!(places.establish(first.id).is_err(), "evicted");
    }

    #[test]
    fn a_newcomer_of_another_source_gets_a_place_from_the_flooding_one() {
        let mut places = Places::new(LIMITS);
        let ids: Vec<_> = (0..3).map(|_| admit(&mut places, 2).id).collect();
        let newcomer = admit(&mut places, 1);
        let oldest = Evicted {
            id: ids[0],
            source: source(2),
        };
        assert_eq!(newcomer.evicted, Some(oldest));
    }

    #[test]
    fn handshakes_that_end_slowly_are_bounded() {
        let mut places = Places::new(LIMITS);
        let outcomes: Vec<_> = (0..20).map(|_| places.admit(&source(2)).is_ok()).collect();
        assert_eq!(outcomes.iter().filter(|admitted| **admitted).count(), 6);
        assert_eq!(places.admit(&source(1)), Err(Refusal::Busy));
    }

    #[test]
    fn sessions_are_limited_in_total_and_for_each_source() {
        let mut places = Places::new(LIMITS);
        for _ in 0..2 {
            establish(&mut places, 1).expect("room");
        }
        let refusal = establish(&mut places, 1).expect_err("too many of one source");
        assert_eq!(refusal, Refusal::SessionsOfSource(2));
        let last = [2, 3].map(|number| establish(&mut places, number).expect("room"))[1];
        let refusal = establish(&mut places, 4).expect_err("too many");
        assert_eq!(refusal, Refusal::Sessions(4));
        places.release(last);
        establish(&mut places, 4).expect("room again");
    }

    #[test]
    fn handshakes_that_complete_together_do_not_exceed_the_sessions() {
        let mut places = Places::new(LIMITS);
        let ids: Vec<_> = (0..3).map(|_| admit(&mut places, 1).id).collect();
        let established: Vec<_> = ids.iter().map(|id| places.establish(*id).is_ok()).collect();
        assert_eq!(established, [true, true, false]);
    }

    #[test]
    fn a_source_is_what_a_peer_cannot_choose() {
        let of = |text: &str| Source::of(&text.parse().expect("a locator"));
        for local in [
            "tcp/127.0.0.1:7447",
            "tcp/127.3.2.1:1",
            "udp/[::1]:7447",
            "tcp/[::ffff:127.0.0.1]:7447",
            "unixsock-stream//run/rect/router.sock",
        ] {
            assert_eq!(of(local), Source::ThisComputer, "{local}");
        }
        assert_eq!(of("tcp/10.0.0.1:5000"), source(1));
        assert_eq!(of("ws/[::ffff:10.0.0.1]:5000"), source(1));
        assert_eq!(of("tcp/[2001:db8::1]:1"), of("tcp/[2001:db8::ffff:2]:9"));
        assert_ne!(of("tcp/[2001:db8::1]:1"), of("tcp/[2001:db8:0:1::1]:1"));
        let serial = Source::Protocol("serial".to_owned());
        assert_eq!(of("serial//dev/ttyUSB0"), serial);
    }
}
