//! Reports the state of all `multi` links of the process.
use std::time::Duration;

use crate::{hub::Hub, multipath::PathReport};

/// The state of a link.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkStatus {
    /// The peer.
    pub peer: String,
    /// How long the link has been open.
    pub up: Duration,
    /// Whether further paths can be added, and all are encrypted.
    pub is_encrypted: bool,
    /// Its paths.
    pub paths: Vec<PathReport>,
    /// Number of changes of the path that carries the bulk.
    pub switches: u64,
}

/// Returns the state of each link.
pub fn links() -> Vec<LinkStatus> {
    let links = Hub::all_links().into_iter();
    links
        .map(|link| LinkStatus {
            peer: link.peer.clone(),
            up: link.since.elapsed(),
            is_encrypted: link.proof.is_some(),
            paths: link.paths(),
            switches: link.switches(),
        })
        .collect()
}
