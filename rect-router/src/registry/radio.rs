//! Collects the links over Bluetooth, those over several paths, and the discovered robots for the registry.
use rect_core::registry::connection::{LinkLane, LinkPath, PathSwitch};
use zenoh::session::Link;
use zenoh_config::EndPoint;
use zenoh_link_any::{
    locator::has_radio,
    status::{self as any, LinkStatus as AnyStatus},
    ANY_LOCATOR_PREFIX as ANY,
};
use zenoh_link_ble::status::{nodes, DiscoveredStatus, LanesStatus, LinkStatus, RefusedStatus};

use super::LinkTraffic;
use crate::paths::{self, traffic};

/// The status of all links of which Bluetooth is a part.
pub struct Radio {
    /// Open Bluetooth links, which may be paths of others.
    pub links: Vec<LinkStatus>,
    /// Open links over several paths.
    any: Vec<AnyStatus>,
    /// Robots whose advertisements were received within the last minute.
    pub discovered: Vec<DiscoveredStatus>,
    /// Peers that have asked for a link within the last minute and got none.
    pub refused: Vec<RefusedStatus>,
}

impl Radio {
    /// Returns the current status.
    pub fn now() -> Self {
        let (mut links, mut discovered, mut refused) = (Vec::new(), Vec::new(), Vec::new());
        for node in nodes() {
            links.extend(node.links);
            discovered.extend(node.discovered);
            refused.extend(node.refused);
        }
        Self {
            links,
            any: any::links(),
            discovered,
            refused,
        }
    }

    /// Returns the Bluetooth status of a link; `None` if it has none.
    pub fn link(&self, link: &Link) -> Option<&LinkStatus> {
        if !has_radio(link.dst().protocol().as_str()) {
            return None;
        }
        let peer = link.dst().address().as_str();
        self.links.iter().find(|radio| radio.peer == peer)
    }

    /// Returns the status of a link over several paths; `None` if it is of another kind.
    pub fn any(&self, link: &Link) -> Option<&AnyStatus> {
        if link.dst().protocol().as_str() != ANY {
            return None;
        }
        let peer = link.dst().address().as_str();
        self.any.iter().find(|any| any.peer == peer)
    }

    /// Returns the paths of a link.
    pub fn paths(&self, link: &Link) -> Option<Vec<LinkPath>> {
        self.any(link).map(paths::paths_of)
    }

    /// Returns how often the path that carries the bulk of a link was replaced.
    pub fn switches(&self, link: &Link) -> Option<u64> {
        self.any(link).map(|any| any.switches)
    }

    /// Returns the last time it was.
    pub fn last_switch(&self, link: &Link) -> Option<PathSwitch> {
        paths::last_switch_of(self.any(link)?)
    }

    /// Returns the lanes of a link.
    pub fn lanes(&self, link: &Link) -> Option<Vec<LinkLane>> {
        match self.any(link) {
            Some(any) => Some(paths::lanes_of(any)),
            None => self.link(link)?.lanes.as_ref().map(lanes_of_radio),
        }
    }

    /// Returns whether a link is encrypted; `None` if it is of another kind.
    pub fn is_encrypted(&self, link: &Link) -> Option<bool> {
        match self.any(link) {
            Some(any) => Some(any.is_encrypted),
            None => self.link(link).map(|radio| radio.encrypted),
        }
    }

    /// Returns the traffic of a link, which counts batches and bytes.
    pub fn carried(&self, link: &Link) -> Option<LinkTraffic> {
        if let Some(any) = self.any(link) {
            let primary = any.paths.iter().find(|path| path.is_primary);
            let round_trip = primary.and_then(|path| path.round_trip);
            return Some(LinkTraffic {
                sent: traffic(any.sent),
                received: traffic(any.received),
                round_trip_ms: round_trip.map(|time| time.as_secs_f64() * 1000.0),
            });
        }
        let radio = self.link(link)?;
        Some(LinkTraffic {
            sent: traffic(radio.sent),
            received: traffic(radio.received),
            round_trip_ms: radio.lanes.as_ref().and_then(|lanes| lanes.round_trip_ms),
        })
    }

    /// Returns whether the peer of a link is the one that an endpoint names. Two robots have one link over Bluetooth at most, of
    /// either kind.
    pub fn leads_to(&self, link: &Link, endpoint: &EndPoint) -> bool {
        let address = endpoint.address().as_str();
        let is_address = self
            .link(link)
            .is_some_and(|radio| radio.peer == address || radio.address == address);
        let is_name = || {
            has_radio(link.dst().protocol().as_str()) && link.dst().address().as_str() == address
        };
        let is_met = || {
            let any = self.any(link);
            any.is_some_and(|any| any.addresses.iter().any(|met| met == address))
        };
        has_radio(endpoint.protocol().as_str()) && (is_address || is_name() || is_met())
    }

    /// Returns the signal strength of the discovered robot with the name or address `peer`.
    pub fn rssi_dbm(&self, peer: &str) -> Option<i16> {
        let is_peer = |robot: &&DiscoveredStatus| {
            robot.address == peer || robot.name.as_deref() == Some(peer)
        };
        self.discovered.iter().find(is_peer)?.rssi_dbm
    }
}

fn lanes_of_radio(status: &LanesStatus) -> Vec<LinkLane> {
    let lanes = status.lanes.iter().map(|lane| LinkLane {
        priority: lane.priority.clone(),
        waiting_bytes: lane.unsent_bytes,
        delay_ms: lane.delay_ms,
        dropped_batches: lane.abandoned,
    });
    lanes.collect()
}
