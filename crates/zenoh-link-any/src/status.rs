//! Reports the state of all `any` links of the process.
use std::time::Duration;

use link_lanes::{
    lanes::{report::Count, Lane},
    usage::UsageReport,
};

use crate::{
    hub::Hub,
    multipath::{LaneReport, PathReport, Switch},
    path::Medium,
};

/// The state of a link.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkStatus {
    /// The peer.
    pub peer: String,
    /// The addresses of locators at which the peer has answered.
    pub addresses: Vec<String>,
    /// How long the link has been open.
    pub up: Duration,
    /// Whether further paths can be added, and all are encrypted.
    pub is_encrypted: bool,
    /// Its paths.
    pub paths: Vec<PathReport>,
    /// The lanes that were used, the most urgent first.
    pub lanes: Vec<(Lane, LaneReport)>,
    /// The batches sent.
    pub sent: Count,
    /// The batches received.
    pub received: Count,
    /// How often the path that carries the bulk was replaced: by another one, or by itself after it had been silent.
    pub switches: u64,
    /// The last time it was.
    pub last_switch: Option<Switch>,
}

/// The bytes that a link has sent over one medium, by key.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkUsage {
    /// The peer.
    pub peer: String,
    /// The medium.
    pub medium: Medium,
    /// The bytes that were counted.
    pub report: UsageReport,
    /// Rate of the medium while there is enough to send, per second in the unit of the costs in the report, if it was measured.
    pub rate_per_s: Option<f64>,
}

/// Returns what each link of this process has sent for each key. The links count from the first question on until `keep` after the
/// last one.
pub fn usage(keep: Duration) -> Vec<LinkUsage> {
    let links: Vec<_> = Hub::all().iter().flat_map(|hub| hub.links()).collect();
    let mut usage = Vec::new();
    for link in links {
        let paths = link.paths();
        for (medium, report) in link.usage(keep) {
            let measured = |path: &&PathReport| path.medium == medium && path.is_measured;
            let measured = paths.iter().find(measured);
            usage.push(LinkUsage {
                peer: link.peer.clone(),
                medium,
                report,
                rate_per_s: measured.map(|path| path.rate_bytes_per_s),
            });
        }
    }
    usage
}

/// Returns the state of each link.
pub fn links() -> Vec<LinkStatus> {
    let hubs = Hub::all();
    let links = hubs
        .iter()
        .flat_map(|hub| hub.links().into_iter().map(move |link| (hub, link)));
    links
        .map(|(hub, link)| {
            let (sent, received) = link.traffic();
            let (switches, last_switch) = link.switches();
            LinkStatus {
                peer: link.peer.clone(),
                addresses: hub.addresses_of(&link.peer),
                up: link.since.elapsed(),
                is_encrypted: link.proof.is_some(),
                paths: link.paths(),
                lanes: link.lanes(),
                sent,
                received,
                switches,
                last_switch,
            }
        })
        .collect()
}
