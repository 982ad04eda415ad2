//! The network interfaces of this computer: which addresses are offered, and which of a peer's are dialled.
use std::net::{IpAddr, SocketAddr};

use if_addrs::{IfAddr, Interface};

/// Returns the addresses to offer: those of the given interfaces, or of all but the loopback interface. Link-local addresses of
/// IPv6 are left out: they are valid only together with the number of the peer's interface.
pub(crate) fn own_addresses(interfaces: Option<&[String]>) -> Vec<IpAddr> {
    let addresses = used(interfaces).map(|interface| interface.ip());
    addresses
        .filter(|address| match address {
            IpAddr::V4(_) => true,
            IpAddr::V6(address) => !address.is_unicast_link_local(),
        })
        .collect()
}

/// Returns those of a peer's addresses that are in one of this computer's networks. Others are never dialled, so that an offer
/// cannot turn a robot into a scanner of foreign networks.
pub(crate) fn reachable(offered: &[SocketAddr], interfaces: Option<&[String]>) -> Vec<SocketAddr> {
    let networks: Vec<_> = used(interfaces).collect();
    let is_own = |address: &SocketAddr| networks.iter().any(|own| own.ip() == address.ip());
    let is_in_network = |address: &&SocketAddr| {
        let mut networks = networks.iter();
        networks.any(|own| is_same_network(&own.addr, address.ip()))
    };
    let found = offered.iter().filter(is_in_network);
    // An address that both have is of the same computer, as in a simulation, or of two networks with the same numbers.
    let is_loopback = |address: &SocketAddr| address.ip().is_loopback();
    found
        .filter(|address| is_loopback(address) || !is_own(address))
        .copied()
        .collect()
}

/// Returns all addresses of interfaces that are up.
pub(crate) fn working_addresses() -> Vec<IpAddr> {
    working().map(|interface| interface.ip()).collect()
}

fn working() -> impl Iterator<Item = Interface> {
    let all = if_addrs::get_if_addrs().unwrap_or_default();
    all.into_iter().filter(Interface::is_oper_up)
}

fn used(interfaces: Option<&[String]>) -> impl Iterator<Item = Interface> + '_ {
    working().filter(move |interface| match interfaces {
        Some(names) => names.contains(&interface.name),
        None => !interface.is_loopback(),
    })
}

fn is_same_network(own: &IfAddr, address: IpAddr) -> bool {
    match (own, address) {
        (IfAddr::V4(own), IpAddr::V4(address)) => {
            let mask = own.netmask.to_bits();
            own.ip.to_bits() & mask == address.to_bits() & mask
        }
        (IfAddr::V6(own), IpAddr::V6(address)) => {
            let mask = own.netmask.to_bits();
            own.ip.to_bits() & mask == address.to_bits() & mask
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_in_own_networks_are_dialled() {
        let lo = ["lo".to_owned()];
        let addresses = [
            "127.0.0.1:5",
            "127.9.9.9:6",
            "192.0.2.7:7",
            "[2001:db8::1]:8",
        ];
        let offered = addresses.map(|text| text.parse().expect("an address"));
        let dialled = reachable(&offered, Some(&lo));
        assert_eq!(dialled, offered[..2]);
        assert_eq!(reachable(&offered, Some(&[])), []);
        assert!(reachable(&offered, None)
            .iter()
            .all(|a| !a.ip().is_loopback()));
    }
}
