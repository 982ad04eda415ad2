//! Owns what the registry takes from the radio: its links, and whom it hears.
use rect::core::connection::Traffic;
use zenoh::session::Link;
use zenoh_config::EndPoint;
use zenoh_link::ble::{
    status::{nodes, Count, HeardStatus, LinkStatus},
    BLE_LOCATOR_PREFIX as BLE,
};

use super::Carried;

/// What the radio tells.
pub struct Ble {
    /// Open ones.
    pub links: Vec<LinkStatus>,
    /// Within a minute.
    pub heard: Vec<HeardStatus>,
}

impl Ble {
    /// Of all adapters.
    pub fn now() -> Self {
        let (mut links, mut heard) = (Vec::new(), Vec::new());
        for node in nodes() {
            links.extend(node.links);
            heard.extend(node.heard);
        }
        Self { links, heard }
    }

    /// What the radio tells of that link.
    pub fn link(&self, link: &Link) -> Option<&LinkStatus> {
        if link.dst().protocol().as_str() != BLE {
            return None;
        }
        let peer = link.dst().address().as_str();
        self.links.iter().find(|radio| radio.peer == peer)
    }

    /// What the radio counts on that link.
    pub fn carried(&self, link: &Link) -> Option<Carried> {
        let radio = self.link(link)?;
        Some(Carried {
            sent: traffic(radio.sent),
            received: traffic(radio.received),
            round_trip_ms: radio.lanes.as_ref().and_then(|lanes| lanes.round_trip_ms),
        })
    }

    /// Whether that link is with the peer that a `ble/` endpoint names.
    pub fn leads_to(&self, link: &Link, endpoint: &EndPoint) -> bool {
        let wanted = endpoint.address().as_str();
        endpoint.protocol().as_str() == BLE
            && (self.link(link)).is_some_and(|l| l.peer == wanted || l.address == wanted)
    }

    /// Of whoever goes by that name or address.
    pub fn rssi_dbm(&self, peer: &str) -> Option<i16> {
        let is_it =
            |heard: &&HeardStatus| heard.address == peer || heard.name.as_deref() == Some(peer);
        self.heard.iter().find(is_it)?.rssi_dbm
    }
}

fn traffic(count: Count) -> Traffic {
    Traffic {
        batches: Some(count.sdus),
        bytes: count.bytes,
    }
}
