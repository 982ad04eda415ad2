//! Remembers for a while which devices did not prove that they have this node's secret. A node that dials any robot of its
//! fleet skips them, because a fleet is identified by a hash of only 16 bits, and any device can advertise it.
//!
//! `pending_handshakes` uses the same list for addresses whose handshakes failed.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};
use zenoh_link_ble_radio::address::DeviceAddress;

/// How long a device is remembered. It is short enough that a device which has been given the right secret is soon dialled
/// again.
const EXPIRY: Duration = Duration::from_secs(60);
/// Largest number of remembered devices; the oldest are forgotten. A device that changes its address with each attempt is
/// not recognised in any case.
const MAX_PEERS: usize = 64;

/// The rejected devices with the times until which they are remembered, the latest first.
#[derive(Debug, Default)]
pub(crate) struct RejectedPeers(VecDeque<(DeviceAddress, Instant)>);

impl RejectedPeers {
    /// Adds a device, or extends the time for which it is remembered.
    pub(crate) fn insert(&mut self, device: DeviceAddress, now: Instant) {
        self.remove(device);
        self.0.truncate(MAX_PEERS - 1);
        self.0.push_front((device, now + EXPIRY));
    }

    /// Removes a device whose handshake has succeeded since.
    pub(crate) fn remove(&mut self, device: DeviceAddress) {
        self.0.retain(|(known, _)| *known != device);
    }

    /// Returns whether a device is remembered.
    pub(crate) fn contains(&self, device: DeviceAddress, now: Instant) -> bool {
        let is_rejected =
            |(known, until): &(DeviceAddress, Instant)| *known == device && now < *until;
        self.0.iter().any(is_rejected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenoh_link_ble_radio::address::{Address, AddressType};

    fn device(number: u8) -> DeviceAddress {
        DeviceAddress {
            address: Address([0, 0, 0, 0, 0, number]),
            kind: AddressType::Public,
        }
    }

    #[test]
    fn rejected_peer_is_remembered_for_a_minute() {
        let (mut rejected_peers, start) = (RejectedPeers::default(), Instant::now());
        rejected_peers.insert(device(1), start);
        let end = start + EXPIRY;
        assert!(rejected_peers.contains(device(1), end - Duration::from_millis(1)));
        assert!(!rejected_peers.contains(device(1), end));
        rejected_peers.insert(device(1), start);
        rejected_peers.remove(device(1));
        assert!(!rejected_peers.contains(device(1), start));
        assert!(!rejected_peers.contains(device(2), start));
    }

    #[test]
    fn number_of_remembered_peers_is_bounded() {
        let (mut rejected_peers, now) = (RejectedPeers::default(), Instant::now());
        for _ in 0..3 {
            (0..=255).for_each(|number| rejected_peers.insert(device(number), now));
        }
        assert_eq!(rejected_peers.0.len(), MAX_PEERS);
        assert!(
            rejected_peers.contains(device(255), now) && !rejected_peers.contains(device(0), now)
        );
    }
}
