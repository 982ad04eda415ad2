//! Limits the connections to a server. If there are too many, a new connection evicts an older one, so that connections that do
//! nothing keep nobody out.
use std::{
    cmp::Reverse,
    net::{IpAddr, Ipv4Addr, Ipv6Addr},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use tokio::sync::oneshot;

/// The permits for connections.
pub struct Permits {
    max: usize,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    next_id: u64,
    granted: Vec<Granted>,
}

struct Granted {
    /// Its number, in the order of the connections.
    id: u64,
    block: IpAddr,
    is_known: bool,
    /// Dropped when the connection is evicted.
    _keeps: oneshot::Sender<()>,
}

/// The permit of a connection; dropping it releases it.
pub struct Permit {
    permits: Arc<Permits>,
    id: u64,
    kept: oneshot::Receiver<()>,
}

impl Permits {
    /// Creates the permits for at most `max` connections.
    pub fn new(max: usize) -> Arc<Self> {
        Arc::new(Self {
            max,
            state: Mutex::default(),
        })
    }

    /// Grants a new connection a permit. `is_known`: somebody has logged in from that address.
    ///
    /// If there are too many connections, the oldest one of the [block](address_block) with the most is evicted. Connections from
    /// known addresses are evicted only if there are no others. Returns `None` if that leaves only the new connection to evict.
    pub fn grant(self: &Arc<Self>, from: IpAddr, is_known: bool) -> Option<Permit> {
        let mut state = self.state();
        let (keeps, kept) = oneshot::channel();
        let id = state.next_id;
        state.next_id += 1;
        state.granted.push(Granted {
            id,
            block: address_block(from),
            is_known,
            _keeps: keeps,
        });
        let is_full = state.granted.len() > self.max;
        let evicted = is_full.then(|| evict(&mut state.granted));
        (evicted != Some(id)).then(|| Permit {
            permits: self.clone(),
            id,
            kept,
        })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Permit {
    /// Waits until the connection is evicted.
    pub async fn evicted(&mut self) {
        // The sender never sends; it is dropped.
        let _ = (&mut self.kept).await;
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut state = self.permits.state();
        state.granted.retain(|other| other.id != self.id);
    }
}

/// Returns the addresses that one computer can choose freely: the first 64 bits of an IPv6 address, all addresses of the loopback
/// interface, or else the address itself.
pub fn address_block(ip: IpAddr) -> IpAddr {
    match ip.to_canonical() {
        ip if ip.is_loopback() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) => Ipv6Addr::from_bits(ip.to_bits() >> 64 << 64).into(),
        ip @ IpAddr::V4(_) => ip,
    }
}

/// Removes the connection that is evicted, and returns its number.
fn evict(granted: &mut Vec<Granted>) -> u64 {
    let all_are_known = granted.iter().all(|one| one.is_known);
    let candidates = || granted.iter().filter(|one| all_are_known || !one.is_known);
    let in_block = |block| candidates().filter(|one| one.block == block).count();
    let evicted = candidates().max_by_key(|one| (in_block(one.block), Reverse(one.id)));
    let evicted = evicted.map_or(0, |one| one.id);
    granted.retain(|one| one.id != evicted);
    evicted
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ip(text: &str) -> IpAddr {
        text.parse().expect("an address")
    }

    fn is_evicted(permit: &mut Permit) -> bool {
        permit.kept.try_recv() == Err(oneshot::error::TryRecvError::Closed)
    }

    #[test]
    fn a_new_connection_evicts_the_oldest_of_the_block_with_the_most() {
        let permits = Permits::new(4);
        let grant = |from: &str| permits.grant(ip(from), false).expect("a permit");
        let mut lone = grant("10.0.0.1");
        let mut first = grant("fd00::1");
        let mut second = grant("fd00::2");
        let released = grant("10.0.0.2");
        drop(released);
        let mut third = grant("fd00::3");
        assert!(![&mut lone, &mut first, &mut second, &mut third]
            .into_iter()
            .any(is_evicted));
        let mut new = grant("10.0.0.3");
        assert!(is_evicted(&mut first));
        let _newer = grant("fd00::4");
        assert!(is_evicted(&mut second));
        assert!(![&mut lone, &mut third, &mut new]
            .into_iter()
            .any(is_evicted));
    }

    #[test]
    fn connections_from_known_addresses_are_evicted_last() {
        let permits = Permits::new(2);
        let grant = |from: &str, is_known| permits.grant(ip(from), is_known);
        let mut known = grant("10.0.0.1", true).expect("a permit");
        let mut other = grant("10.0.0.2", false).expect("a permit");
        let mut second = grant("10.0.0.1", true).expect("a permit");
        assert!(is_evicted(&mut other) && !is_evicted(&mut known));
        assert!(grant("10.0.0.2", false).is_none());
        assert!(!is_evicted(&mut known) && !is_evicted(&mut second));
        let third = grant("10.0.0.1", true);
        assert!(third.is_some() && is_evicted(&mut known));
    }

    #[test]
    fn the_permit_of_an_evicted_connection_releases_no_other() {
        let permits = Permits::new(1);
        let grant = || permits.grant(ip("10.0.0.1"), false).expect("a permit");
        let first = grant();
        drop(grant());
        let mut third = grant();
        drop(first);
        assert!(!is_evicted(&mut third));
        let _fourth = grant();
        assert!(is_evicted(&mut third));
    }

    #[test]
    fn a_block_contains_the_addresses_that_one_computer_can_choose() {
        let same = |one, other| address_block(ip(one)) == address_block(ip(other));
        assert!(
            same("fd00:0:0:1::1", "fd00:0:0:1:2:3:4:5") && !same("fd00:0:0:1::1", "fd00:0:0:2::1")
        );
        assert!(same("::ffff:10.0.0.1", "10.0.0.1") && !same("::ffff:10.0.0.1", "::ffff:10.0.0.2"));
        assert!(same("127.0.0.1", "127.1.2.3") && same("127.0.0.1", "::1"));
    }
}
