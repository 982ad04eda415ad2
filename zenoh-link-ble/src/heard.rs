//! Owns who was heard lately, linked or not: for people, and to tell how strong a peer's signal is. Bounded: a hall full of
//! devices pushes out the ones not heard for longest.
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::{address::DeviceAddress, radio::Sighting};

/// How long somebody counts as being there. A robot advertises ten times a second, but nobody may be looking.
const LATELY: Duration = Duration::from_secs(60);
/// How many are remembered: more than a hall has, as each new one is asked for its name.
const REMEMBERED: usize = 256;

/// A node that was heard.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HeardStatus {
    /// Its Bluetooth address.
    pub address: String,
    /// Its name, where the radio tells.
    pub name: Option<String>,
    /// The fleet it advertises; 0: none (`Advertisement::hash_of_fleet`).
    pub fleet_hash: u16,
    /// How strong its signal was.
    pub rssi_dbm: Option<i16>,
    /// Seconds since then.
    pub ago_s: f64,
}

#[derive(Debug)]
struct Node {
    device: DeviceAddress,
    name: Option<String>,
    fleet_hash: u16,
    rssi_dbm: Option<i16>,
    at: Instant,
}

/// All nodes heard lately, the last at the end.
#[derive(Debug, Default)]
pub(crate) struct Heard(Vec<Node>);

impl Heard {
    /// Tells whether it is the first time, lately: its name is not known then. Who does not advertise as a node does not count.
    pub(crate) fn on_seen(&mut self, sighting: &Sighting, now: Instant) -> bool {
        let Some(advertisement) = &sighting.advertisement else {
            return false;
        };
        self.0.retain(|node| is_recent(node, now));
        let at = self.0.iter().position(|n| n.device == sighting.device);
        let known = at.map(|at| self.0.remove(at));
        if self.0.len() == REMEMBERED {
            self.0.remove(0);
        }
        let is_new = known.is_none();
        let known = known.as_ref();
        self.0.push(Node {
            device: sighting.device,
            name: known.and_then(|node| node.name.clone()),
            fleet_hash: advertisement.fleet_hash,
            rssi_dbm: sighting.rssi_dbm.or(known.and_then(|node| node.rssi_dbm)),
            at: now,
        });
        is_new
    }

    /// The radio knows its name.
    pub(crate) fn on_name(&mut self, device: DeviceAddress, name: String) {
        if let Some(node) = self.0.iter_mut().find(|node| node.device == device) {
            node.name = Some(name);
        }
    }

    pub(crate) fn status(&self, now: Instant) -> Vec<HeardStatus> {
        let recent = self.0.iter().filter(|node| is_recent(node, now));
        let status = |node: &Node| HeardStatus {
            address: node.device.to_string(),
            name: node.name.clone(),
            fleet_hash: node.fleet_hash,
            rssi_dbm: node.rssi_dbm,
            ago_s: now.saturating_duration_since(node.at).as_secs_f64(),
        };
        recent.map(status).collect()
    }
}

fn is_recent(node: &Node, now: Instant) -> bool {
    now.saturating_duration_since(node.at) < LATELY
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        address::{Address, AddressType, Psm},
        advertisement::Advertisement,
    };

    fn sighting(number: u8, rssi_dbm: Option<i16>) -> Sighting {
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
        Sighting {
            device,
            advertisement,
            rssi_dbm,
        }
    }

    #[test]
    fn a_node_is_there_for_a_minute_with_its_name_and_the_last_signal() {
        let (mut heard, start) = (Heard::default(), Instant::now());
        assert!(heard.on_seen(&sighting(1, Some(-60)), start), "new");
        heard.on_name(sighting(1, None).device, "wombat-1".to_owned());
        let later = start + LATELY / 2;
        assert!(!heard.on_seen(&sighting(1, None), later), "known");
        let expected = HeardStatus {
            address: "00:00:00:00:00:01".to_owned(),
            name: Some("wombat-1".to_owned()),
            fleet_hash: 2,
            rssi_dbm: Some(-60),
            ago_s: 30.0,
        };
        assert_eq!(heard.status(start + LATELY), [expected]);
        assert_eq!(heard.status(later + LATELY), []);
        assert!(heard.on_seen(&sighting(1, None), later + LATELY), "anew");
    }

    #[test]
    fn who_is_no_node_does_not_count_and_a_crowd_has_a_bound() {
        let (mut heard, now) = (Heard::default(), Instant::now());
        let other = Sighting {
            advertisement: None,
            ..sighting(1, None)
        };
        assert!(!heard.on_seen(&other, now));
        assert!(heard.status(now).is_empty());
        for number in 0..300_u16 {
            let [high, low] = number.to_be_bytes();
            let mut one = sighting(low, None);
            one.device.address.0[4] = high;
            heard.on_seen(&one, now);
        }
        assert_eq!(heard.status(now).len(), REMEMBERED);
    }
}
