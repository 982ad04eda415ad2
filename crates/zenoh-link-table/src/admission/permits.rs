//! Decides which accepted links are admitted; logic without I/O.

use std::{
    collections::HashMap,
    fmt,
    net::{IpAddr, Ipv6Addr, SocketAddr},
    time::Duration,
};

use zenoh_protocol::core::Locator;

/// Limits of accepted links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Maximum number of unfinished handshakes; 0 counts as 1. One more evicts the oldest handshake of the source that
    /// has the most.
    pub handshakes: usize,
    /// Maximum number of sessions (links with a completed handshake), of all sources.
    pub sessions: usize,
    /// Maximum number of sessions of one source.
    pub sessions_per_source: usize,
    /// Maximum duration of a handshake.
    pub handshake_timeout: Duration,
}

/// Origin of a link, as far as a peer cannot choose it freely.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Source {
    /// A program on this computer, over loopback or a socket file.
    ThisComputer,
    /// An IPv4 address, or the first 64 bits of an IPv6 address: a computer can choose the other bits.
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

/// Reasons why a link is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Newer handshakes needed room, and this one was the oldest of its source.
    #[error("too many connections that have not logged in; the oldest is closed for a new one")]
    Handshakes,
    /// Evicted links have not closed yet.
    #[error("connections arrive faster than they can be closed")]
    Busy,
    /// The limit of sessions of the router is reached.
    #[error("all {0} sessions for links other than Bluetooth are in use (transport/unicast/max_sessions)")]
    Sessions(usize),
    /// The limit of sessions of one source is reached.
    #[error("the address already has the maximum of {0} sessions (docs/reference/configuration.md, \"How many may connect\")")]
    SessionsOfSource(usize),
}

/// Identifies a permit; never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PermitId(u64);

/// A permit that was granted to a new link.
#[derive(Debug, PartialEq, Eq)]
pub struct Admitted {
    /// Id of the new permit.
    pub id: PermitId,
    /// Link that must end to make room for it.
    pub evicted: Option<Evicted>,
}

/// A link that lost its permit.
#[derive(Debug, PartialEq, Eq)]
pub struct Evicted {
    pub id: PermitId,
    pub source: Source,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Handshake,
    Established,
    /// Evicted or refused, but still held by Zenoh.
    Ending,
}

/// All accepted links that Zenoh holds.
pub struct Permits {
    limits: Limits,
    next: u64,
    links: HashMap<PermitId, (Source, Stage)>,
}

impl Permits {
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            next: 0,
            links: HashMap::new(),
        }
    }

    /// Grants a new link a permit for its handshake.
    ///
    /// # Errors
    /// Fails if the limit of sessions is reached, or if too many evicted links have not closed yet.
    pub fn admit(&mut self, source: &Source) -> Result<Admitted, Refusal> {
        self.check_limits(source)?;
        // At most as many links may be ending as may be in a handshake. This bounds the resources that a flood can take
        // from Zenoh.
        if self.count(|_, stage| stage == Stage::Ending) >= self.limits.handshakes.max(1) {
            return Err(Refusal::Busy);
        }
        let in_progress = self.count(|_, stage| stage == Stage::Handshake);
        let mut evicted = None;
        if in_progress >= self.limits.handshakes.max(1) {
            evicted = self.evict(source);
        }
        let id = PermitId(self.next);
        self.next += 1;
        self.links.insert(id, (source.clone(), Stage::Handshake));
        Ok(Admitted { id, evicted })
    }

    /// Counts a link as a session, because its handshake is complete.
    ///
    /// # Errors
    /// Fails if the limit of sessions is reached, or if the link was evicted.
    pub fn establish(&mut self, id: PermitId) -> Result<(), Refusal> {
        let Some((source, Stage::Handshake)) = self.links.get(&id).cloned() else {
            // The link was evicted at the same moment.
            return Err(Refusal::Handshakes);
        };
        let room = self.check_limits(&source);
        let stage = match room {
            Ok(()) => Stage::Established,
            Err(_) => Stage::Ending,
        };
        self.links.insert(id, (source, stage));
        room
    }

    /// Releases the permit of a link that Zenoh has dropped.
    pub fn release(&mut self, id: PermitId) {
        self.links.remove(&id);
    }

    fn check_limits(&self, source: &Source) -> Result<(), Refusal> {
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

    /// Evicts the oldest handshake of the source that has the most of them. `newcomer` counts as one more of its
    /// source.
    fn evict(&mut self, newcomer: &Source) -> Option<Evicted> {
        let mut by_source: HashMap<&Source, (usize, PermitId)> = HashMap::new();
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
        // If two sources have the same number, the source whose oldest handshake has waited longer is chosen.
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

    fn admit(permits: &mut Permits, number: u8) -> Admitted {
        permits.admit(&source(number)).expect("is admitted")
    }

    fn establish(permits: &mut Permits, number: u8) -> Result<PermitId, Refusal> {
        let id = permits.admit(&source(number))?.id;
        permits.establish(id)?;
        Ok(id)
    }

    #[test]
    fn flood_of_one_source_evicts_only_its_own_handshakes() {
        let mut permits = Permits::new(LIMITS);
        let honest = admit(&mut permits, 1);
        let first = admit(&mut permits, 2);
        admit(&mut permits, 2);
        for _ in 0..20 {
            let evicted = admit(&mut permits, 2).evicted.expect("evicts one");
            assert_eq!(evicted.source, source(2));
            permits.release(evicted.id);
        }
        assert_eq!(permits.establish(honest.id), Ok(()));
        assert!(permits.establish(first.id).is_err(), "evicted");
    }

    #[test]
    fn newcomer_evicts_a_handshake_of_the_flooding_source() {
        let mut permits = Permits::new(LIMITS);
        let ids: Vec<_> = (0..3).map(|_| admit(&mut permits, 2).id).collect();
        let newcomer = admit(&mut permits, 1);
        let oldest = Evicted {
            id: ids[0],
            source: source(2),
        };
        assert_eq!(newcomer.evicted, Some(oldest));
    }

    #[test]
    fn bounds_evicted_handshakes_that_close_slowly() {
        let mut permits = Permits::new(LIMITS);
        let outcomes: Vec<_> = (0..20).map(|_| permits.admit(&source(2)).is_ok()).collect();
        assert_eq!(outcomes.iter().filter(|admitted| **admitted).count(), 6);
        assert_eq!(permits.admit(&source(1)), Err(Refusal::Busy));
    }

    #[test]
    fn limits_sessions_in_total_and_per_source() {
        let mut permits = Permits::new(LIMITS);
        for _ in 0..2 {
            establish(&mut permits, 1).expect("room");
        }
        let refusal = establish(&mut permits, 1).expect_err("too many of one source");
        assert_eq!(refusal, Refusal::SessionsOfSource(2));
        let last = [2, 3].map(|number| establish(&mut permits, number).expect("room"))[1];
        let refusal = establish(&mut permits, 4).expect_err("too many");
        assert_eq!(refusal, Refusal::Sessions(4));
        permits.release(last);
        establish(&mut permits, 4).expect("room again");
    }

    #[test]
    fn concurrent_handshakes_do_not_exceed_the_session_limit() {
        let mut permits = Permits::new(LIMITS);
        let ids: Vec<_> = (0..3).map(|_| admit(&mut permits, 1).id).collect();
        let established: Vec<_> = ids
            .iter()
            .map(|id| permits.establish(*id).is_ok())
            .collect();
        assert_eq!(established, [true, true, false]);
    }

    #[test]
    fn source_contains_only_what_a_peer_cannot_choose() {
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
