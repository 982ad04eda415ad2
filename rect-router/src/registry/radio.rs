//! Collects the Bluetooth links and the discovered robots for the registry.
use rect::core::connection::Traffic;
use zenoh::session::Link;
use zenoh_config::EndPoint;
use zenoh_link::ble::{
    status::{nodes, Count, DiscoveredStatus, LinkStatus},
    BLE_LOCATOR_PREFIX as BLE,
};

use super::LinkTraffic;

/// The Bluetooth status of all adapters.
pub struct Ble {
    /// Open links.
    pub links: Vec<LinkStatus>,
    /// Robots whose advertisements were received within the last minute.
    pub discovered: Vec<DiscoveredStatus>,
}

impl Ble {
    /// Returns the current status of all adapters.
    pub fn now() -> Self {
        let (mut links, mut discovered) = (Vec::new(), Vec::new());
        for node in nodes() {
            links.extend(node.links);
            discovered.extend(node.discovered);
        }
        Self { links, discovered }
    }

    /// Returns the Bluetooth status of a link; `None` if it is not a Bluetooth link.
    pub fn link(&self, link: &Link) -> Option<&LinkStatus> {
        if link.dst().protocol().as_str() != BLE {
            return None;
        }
        let peer = link.dst().address().as_str();
        self.links.iter().find(|radio| radio.peer == peer)
    }

    /// Returns the traffic of a Bluetooth link, which counts batches and bytes.
    pub fn carried(&self, link: &Link) -> Option<LinkTraffic> {
        let radio = self.link(link)?;
        Some(LinkTraffic {
            sent: traffic(radio.sent),
            received: traffic(radio.received),
            round_trip_ms: radio.lanes.as_ref().and_then(|lanes| lanes.round_trip_ms),
        })
    }

    /// Returns whether the peer of a link is the one that a `ble/` endpoint names.
    pub fn leads_to(&self, link: &Link, endpoint: &EndPoint) -> bool {
        let address = endpoint.address().as_str();
        endpoint.protocol().as_str() == BLE
            && (self.link(link)).is_some_and(|l| l.peer == address || l.address == address)
    }

    /// Returns the signal strength of the discovered robot with the name or address `peer`.
    pub fn rssi_dbm(&self, peer: &str) -> Option<i16> {
        let is_peer = |robot: &&DiscoveredStatus| {
            robot.address == peer || robot.name.as_deref() == Some(peer)
        };
        self.discovered.iter().find(is_peer)?.rssi_dbm
    }
}

fn traffic(count: Count) -> Traffic {
    Traffic {
        batches: Some(count.sdus),
        bytes: count.bytes,
    }
}
