//! Keeps the history of each peer: the number of its links, why the last one ended, and which dials failed.
//!
//! The history is bounded. A device that uses many names displaces only the peers whose last event was longest ago.
use std::{collections::VecDeque, time::Instant};

use serde::Serialize;

/// Largest number of peers in the history.
const MAX_PEERS: usize = 64;

/// The end of a link or the failure of a dial.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// The reason, as text for people.
    pub reason: String,
    /// Time since the event, in seconds.
    pub ago_s: f64,
}

/// The history of one peer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PeerStatus {
    /// Name of the peer, or its address if it has no name. For failed dials, the target as given in the locator.
    pub peer: String,
    /// Number of links with it so far; all but the first are reconnections.
    pub links: u64,
    /// Number of failed dials. They were or will be repeated.
    pub failed_dials: u64,
    /// The end of the last link that has ended.
    pub last_end: Option<Event>,
    /// The last failure of a dial.
    pub last_failure: Option<Event>,
}

#[derive(Default)]
struct Peer {
    name: String,
    links: u64,
    failed_dials: u64,
    last_end: Option<(String, Instant)>,
    last_failure: Option<(String, Instant)>,
}

/// The history of all peers. The peer with the latest event is at the end.
#[derive(Default)]
pub(crate) struct History(VecDeque<Peer>);

impl History {
    /// Records a new link with a peer.
    pub(crate) fn on_linked(&mut self, name: &str) {
        self.peer(name).links += 1;
    }

    /// Records the end of a link with a peer.
    pub(crate) fn on_ended(&mut self, name: &str, reason: &str, now: Instant) {
        self.peer(name).last_end = Some((reason.to_owned(), now));
    }

    /// Records a failed dial to a peer.
    pub(crate) fn on_failed_dial(&mut self, name: &str, reason: &str, now: Instant) {
        let peer = self.peer(name);
        peer.failed_dials += 1;
        peer.last_failure = Some((reason.to_owned(), now));
    }

    /// Returns the history of all peers.
    pub(crate) fn status(&self, now: Instant) -> Vec<PeerStatus> {
        let event = |(reason, at): &(String, Instant)| Event {
            reason: reason.clone(),
            ago_s: now.saturating_duration_since(*at).as_secs_f64(),
        };
        let status = |peer: &Peer| PeerStatus {
            peer: peer.name.clone(),
            links: peer.links,
            failed_dials: peer.failed_dials,
            last_end: peer.last_end.as_ref().map(event),
            last_failure: peer.last_failure.as_ref().map(event),
        };
        self.0.iter().map(status).collect()
    }

    /// Returns the history of a peer, which becomes the latest one. Adds the peer if it is new.
    fn peer(&mut self, name: &str) -> &mut Peer {
        let at = self.0.iter().position(|peer| peer.name == name);
        let removed = at.and_then(|at| self.0.remove(at));
        if self.0.len() == MAX_PEERS {
            self.0.pop_front();
        }
        let peer = removed.unwrap_or_else(|| Peer {
            name: name.to_owned(),
            ..Peer::default()
        });
        self.0.push_back(peer);
        let last = self.0.len() - 1;
        &mut self.0[last]
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn links_ends_and_failures_of_a_peer_are_recorded() {
        let (mut history, start) = (History::default(), Instant::now());
        history.on_linked("wombat-2");
        history.on_ended("wombat-2", "it is done", start);
        history.on_failed_dial("wombat-2", "it was not discovered", start);
        history.on_linked("wombat-2");
        let status = history.status(start + Duration::from_secs(3));
        let event = |reason: &str| {
            Some(Event {
                reason: reason.to_owned(),
                ago_s: 3.0,
            })
        };
        let expected = PeerStatus {
            peer: "wombat-2".to_owned(),
            links: 2,
            failed_dials: 1,
            last_end: event("it is done"),
            last_failure: event("it was not discovered"),
        };
        assert_eq!(status, [expected]);
    }

    #[test]
    fn many_names_displace_only_the_oldest() {
        let mut history = History::default();
        for n in 0..1000 {
            history.on_linked("friend");
            history.on_linked(&format!("other {n}"));
        }
        let status = history.status(Instant::now());
        assert_eq!(status.len(), MAX_PEERS);
        assert!(status.iter().any(|p| p.peer == "friend" && p.links == 1000));
    }
}
