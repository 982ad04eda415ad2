//! Owns the account of an air: who is on it, who is linked with whom, and how much was sent.
use serde::{Deserialize, Serialize};

use super::Air;
use crate::radio::{
    sim::{adapter::AdapterStats, condition::Condition, phy::Phy},
    AdapterState,
};

/// An air at one moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AirStatus {
    /// How good it is.
    pub condition: Condition,
    /// The physical layer of every link.
    pub phy: Phy,
    /// Nobody hears anybody.
    pub is_cut: bool,
    /// Pairs that do not hear each other.
    pub cuts: Vec<(String, String)>,
    /// Every adapter, in the order they came.
    pub adapters: Vec<AdapterStatus>,
    /// Every LE connection.
    pub links: Vec<LinkStatus>,
}

/// One adapter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdapterStatus {
    /// Its name.
    pub name: String,
    /// Its address, as it is written; always a random one.
    pub address: String,
    /// `on`, `off` or `missing`.
    pub state: String,
    /// The names it advertises.
    pub advertises: Vec<String>,
    /// It hears advertisements.
    pub scans: bool,
    /// The PSMs it listens on.
    pub listens: Vec<u16>,
    /// What it has sent.
    pub stats: AdapterStats,
}

/// One LE connection.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkStatus {
    /// Who made it.
    pub central: String,
    /// Who was advertising.
    pub peripheral: String,
    /// Channels on it.
    pub channels: usize,
    /// Bytes that wait at the central and at the peripheral.
    pub queued_bytes: [usize; 2],
}

impl Air {
    /// What an adapter has sent so far.
    pub fn stats(&self, name: &str) -> Option<AdapterStats> {
        let id = self.find(name).ok()?;
        self.adapters.get(&id).map(|adapter| adapter.stats)
    }

    /// The account of this moment.
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
            adapter.map_or_else(|| "(gone)".to_owned(), |adapter| adapter.name.clone())
        };
        let links = self.connections.values().map(|connection| LinkStatus {
            central: name(connection.sides[0].adapter),
            peripheral: name(connection.sides[1].adapter),
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

    /// Each pair once.
    fn cut_pairs(&self) -> Vec<(String, String)> {
        let both_ways = self.cuts.iter().flat_map(|(one, deaf_to)| {
            deaf_to
                .iter()
                .map(move |other| (one.clone(), other.clone()))
        });
        both_ways.filter(|(one, other)| one <= other).collect()
    }
}
