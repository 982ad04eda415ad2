//! Keeps track of the nodes whose advertisements were received recently, with or without a link. The registry shows them,
//! and takes the signal strength of peers from them.
//!
//! The number of entries is bounded. If there are more nodes, those that were not received for the longest time are
//! forgotten.
use std::time::{Duration, Instant};

use serde::Serialize;
use zenoh_link_ble_radio::{address::DeviceAddress, AdvertisingReport};

/// How long a node counts as discovered. A robot advertises ten times a second, but this node does not scan all the time.
const EXPIRY: Duration = Duration::from_secs(60);
/// Largest number of entries: more than there are robots in a hall. If there were fewer entries than robots, each robot
/// would count as new again and again, and its name would be requested from the radio each time.
const MAX_NODES: usize = 256;

/// A node whose advertisement was received.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DiscoveredStatus {
    /// Bluetooth address of the node.
    pub address: String,
    /// Name of the node, if the radio knows it.
    pub name: Option<String>,
    /// Hash of the fleet that the node advertises (`Advertisement::hash_of_fleet`); 0 if it has none.
    pub fleet_hash: u16,
    /// Received signal strength in dBm, if the radio reports it.
    pub rssi_dbm: Option<i16>,
    /// Time since the last advertisement, in seconds.
    pub ago_s: f64,
}

#[derive(Debug)]
struct DiscoveredNode {
    device: DeviceAddress,
    name: Option<String>,
    fleet_hash: u16,
    rssi_dbm: Option<i16>,
    at: Instant,
}

/// All nodes that were received recently, the latest at the end.
#[derive(Debug, Default)]
pub(crate) struct DiscoveredNodes(Vec<DiscoveredNode>);

impl DiscoveredNodes {
    /// Records an advertising report. Returns whether the node is new, so that its name is not known yet. Devices without
    /// RECT's advertisement are ignored.
    pub(crate) fn on_report(&mut self, report: &AdvertisingReport, now: Instant) -> bool {
        let Some(advertisement) = &report.advertisement else {
            return false;
        };
        self.0.retain(|node| is_recent(node, now));
        let at = self.0.iter().position(|n| n.device == report.device);
        let known = at.map(|at| self.0.remove(at));
        if self.0.len() == MAX_NODES {
            self.0.remove(0);
        }
        let is_new = known.is_none();
        let known = known.as_ref();
        self.0.push(DiscoveredNode {
            device: report.device,
            name: known.and_then(|node| node.name.clone()),
            fleet_hash: advertisement.fleet_hash,
            rssi_dbm: report.rssi_dbm.or(known.and_then(|node| node.rssi_dbm)),
            at: now,
        });
        is_new
    }

    /// Records the name of a node.
    pub(crate) fn on_name(&mut self, device: DeviceAddress, name: String) {
        if let Some(node) = self.0.iter_mut().find(|node| node.device == device) {
            node.name = Some(name);
        }
    }

    /// Returns the nodes that were received within [`EXPIRY`].
    pub(crate) fn status(&self, now: Instant) -> Vec<DiscoveredStatus> {
        let recent = self.0.iter().filter(|node| is_recent(node, now));
        let status = |node: &DiscoveredNode| DiscoveredStatus {
            address: node.device.to_string(),
            name: node.name.clone(),
            fleet_hash: node.fleet_hash,
            rssi_dbm: node.rssi_dbm,
            ago_s: now.saturating_duration_since(node.at).as_secs_f64(),
        };
        recent.map(status).collect()
    }
}

fn is_recent(node: &DiscoveredNode, now: Instant) -> bool {
    now.saturating_duration_since(node.at) < EXPIRY
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenoh_link_ble_radio::{
        address::{Address, AddressType, Psm},
        advertisement::Advertisement,
    };

    fn report(number: u8, rssi_dbm: Option<i16>) -> AdvertisingReport {
        let device = DeviceAddress {
            address: Address([0, 0, 0, 0, 0, number]),
            kind: AddressType::Public,
        };
        let advertisement = Psm::new(128).map(|psm| Advertisement {
            psm,
            plain: false,
            name_hash: 1,
            fleet_hash: 2,
            incarnation: 3,
        });
        AdvertisingReport {
            device,
            advertisement,
            rssi_dbm,
        }
    }

    #[test]
    fn node_is_listed_for_a_minute_with_its_name_and_last_signal_strength() {
        let (mut nodes, start) = (DiscoveredNodes::default(), Instant::now());
        assert!(nodes.on_report(&report(1, Some(-60)), start), "new");
        nodes.on_name(report(1, None).device, "wombat-1".to_owned());
        let later = start + EXPIRY / 2;
        assert!(!nodes.on_report(&report(1, None), later), "known");
        let expected = DiscoveredStatus {
            address: "00:00:00:00:00:01".to_owned(),
            name: Some("wombat-1".to_owned()),
            fleet_hash: 2,
            rssi_dbm: Some(-60),
            ago_s: 30.0,
        };
        assert_eq!(nodes.status(start + EXPIRY), [expected]);
        assert_eq!(nodes.status(later + EXPIRY), []);
        assert!(
            nodes.on_report(&report(1, None), later + EXPIRY),
            "new again"
        );
    }

    #[test]
    fn other_devices_are_ignored_and_the_number_of_nodes_is_bounded() {
        let (mut nodes, now) = (DiscoveredNodes::default(), Instant::now());
        let other = AdvertisingReport {
            advertisement: None,
            ..report(1, None)
        };
        assert!(!nodes.on_report(&other, now));
        assert!(nodes.status(now).is_empty());
        for number in 0..300_u16 {
            let [high, low] = number.to_be_bytes();
            let mut report = report(low, None);
            report.device.address.0[4] = high;
            nodes.on_report(&report, now);
        }
        assert_eq!(nodes.status(now).len(), MAX_NODES);
    }
}
