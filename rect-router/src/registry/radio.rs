//! Owns what the registry takes from the radio: its links, and whom it hears.
use rect::core::connection::Traffic;
use zenoh::session::Link;
use zenoh_config::EndPoint;
use zenoh_link::ble::{
    status::{nodes, Count, HeardStatus, LinkStatus},
    BLE_LOCATOR_PREFIX as BLE,
};

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

/// As the registry counts.
pub fn traffic(count: Count) -> Traffic {
    Traffic {
        batches: count.sdus,
        bytes: count.bytes,
    }
}

/// There and back, where the link measures it.
pub fn round_trip_ms(radio: &LinkStatus) -> Option<f64> {
    radio.lanes.as_ref()?.round_trip_ms
}
