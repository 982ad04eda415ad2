//! Provides the two functions that the tests of the published crate zenoh-transport take from an unpublished crate of
//! Zenoh's: free ports of the loopback interface. Used by `scripts/test-upstream` only.
use std::{
    collections::BTreeSet,
    net::{TcpListener, UdpSocket},
    sync::Mutex,
};

/// The ports that were assigned, so that each test of a program gets another one.
static ASSIGNED: Mutex<BTreeSet<u16>> = Mutex::new(BTreeSet::new());

/// Returns a TCP port of the loopback interface that no program listens on.
///
/// # Panics
///
/// If the system has no free port.
pub fn get_free_tcp_port() -> u16 {
    new_port(|| {
        let socket = TcpListener::bind("127.0.0.1:0").expect("a free TCP port");
        socket.local_addr().expect("a bound socket").port()
    })
}

/// Returns a UDP port of the loopback interface that no program uses.
///
/// # Panics
///
/// If the system has no free port.
pub fn get_free_udp_port() -> u16 {
    new_port(|| {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a free UDP port");
        socket.local_addr().expect("a bound socket").port()
    })
}

fn new_port(free: impl Fn() -> u16) -> u16 {
    let mut assigned = ASSIGNED.lock().expect("no test panics here");
    std::iter::repeat_with(free)
        .find(|port| assigned.insert(*port))
        .expect("the iterator is endless")
}
