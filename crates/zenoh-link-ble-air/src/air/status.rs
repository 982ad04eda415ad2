//! Reports the status of an air: the attached adapters, the connections between them, and their traffic.
use serde::{Deserialize, Serialize};
use zenoh_link_ble_radio::AdapterState;

use super::Air;

use crate::{adapter::AdapterStats, condition::Condition, phy::Phy};

/// Status of an air.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AirStatus {
    /// Radio condition.
    pub condition: Condition,
    /// Physical layer of every link.
    pub phy: Phy,
    /// Whether the radio contact between all adapters is cut.
    pub is_cut: bool,
    /// Pairs of adapters whose radio contact is cut.
    pub cuts: Vec<(String, String)>,
    /// All adapters, in the order of their attachment.
    pub adapters: Vec<AdapterStatus>,
    /// All LE connections.
    pub links: Vec<LinkStatus>,
}

/// Status of one adapter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdapterStatus {
    /// Name of the adapter.
    pub name: String,
    /// Address of the adapter in text form; always a random address.
    pub address: String,
    /// State of the adapter: `on`, `off` or `missing`.
    pub state: String,
    /// Names that it advertises.
    pub advertises: Vec<String>,
    /// Whether it scans.
    pub scans: bool,
    /// PSMs on which it listens.
    pub listens: Vec<u16>,
    /// Traffic that it has sent.
    pub stats: AdapterStats,
}

/// Status of one LE connection.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkStatus {
    /// Name of the adapter that established the connection.
    pub central: String,
    /// Name of the adapter that was advertising.
    pub peripheral: String,
    /// Connection interval in microseconds.
    pub interval_us: u64,
    /// Number of channels on the connection.
    pub channels: usize,
    /// Bytes queued at the central and at the peripheral.
    pub queued_bytes: [usize; 2],
}

impl Air {
    /// Returns the traffic that an adapter has sent; `None` if it is not attached.
    pub fn stats(&self, name: &str) -> Option<AdapterStats> {
        let id = self.find(name).ok()?;
        self.adapters.get(&id).map(|adapter| adapter.stats)
    }

    /// Returns the current status.
    pub fn status(&self) -> AirStatus {
        let adapters = self.adapters.values().map(|adapter| AdapterStatus {
            name: adapter.name.clone(),
            address: adapter.address.to_string(),
            state: match adapter.state {
                AdapterState::On => "on",
                AdapterState::Off => "off",
                AdapterState::Missing => "missing",
            }
            .to_owned(),
            advertises: adapter
                .advertisements
                .values()
                .map(|advertising| advertising.name.clone())
                .collect(),
            scans: adapter.scan.is_some(),
            listens: adapter.listeners.keys().copied().collect(),
            stats: adapter.stats,
        });
        let name = |id| {
            let adapter = self.adapters.get(&id);
            adapter.map_or_else(|| "(detached)".to_owned(), |adapter| adapter.name.clone())
        };
        let links = self.connections.values().map(|connection| LinkStatus {
            central: name(connection.sides[0].adapter),
            peripheral: name(connection.sides[1].adapter),
            interval_us: u64::try_from(connection.interval.as_micros()).unwrap_or(u64::MAX),
            channels: connection.channels.len(),
            queued_bytes: [0, 1].map(|side| connection.queued_bytes(side)),
        });
        AirStatus {
            condition: self.options.condition,
            phy: self.options.phy,
            is_cut: self.is_cut,
            cuts: self.cut_pairs(),
            adapters: adapters.collect(),
            links: links.collect(),
        }
    }

    /// Returns each pair once.
    fn cut_pairs(&self) -> Vec<(String, String)> {
        let both_ways = self.cuts.iter().flat_map(|(one, blocked)| {
            blocked
                .iter()
                .map(move |other| (one.clone(), other.clone()))
        });
        both_ways.filter(|(one, other)| one <= other).collect()
    }
}
