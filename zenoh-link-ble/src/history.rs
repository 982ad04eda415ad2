//! Owns what is remembered of each peer beyond its links: how often it was linked, what ended the last link, which dials
//! failed. Bounded: a stranger with many names pushes out the ones not heard of for longest, no more.
use std::{collections::VecDeque, time::Instant};

use serde::Serialize;

/// How many peers are remembered.
const PEERS: usize = 64;

/// Something that went wrong or ended, in words, and how long ago.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// The reason.
    pub reason: String,
    /// Seconds since then.
    pub ago_s: f64,
}

/// What is remembered of one peer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PeerStatus {
    /// Its name, or its address where it has none.
    pub peer: String,
    /// Links made with it; all but the first are reconnects.
    pub links: u64,
    /// Dials that came to nothing, and were or will be tried again.
    pub failed_dials: u64,
    /// How the last link ended.
    pub last_end: Option<Event>,
    /// Why the last failed dial did.
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

/// All peers, the one heard of last at the end.
#[derive(Default)]
pub(crate) struct History(VecDeque<Peer>);

impl History {
    pub(crate) fn on_linked(&mut self, name: &str) {
        self.peer(name).links += 1;
    }

    pub(crate) fn on_ended(&mut self, name: &str, reason: &str, now: Instant) {
        self.peer(name).last_end = Some((reason.to_owned(), now));
    }

    pub(crate) fn on_failed_dial(&mut self, name: &str, reason: &str, now: Instant) {
        let peer = self.peer(name);
        peer.failed_dials += 1;
        peer.last_failure = Some((reason.to_owned(), now));
    }

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

    fn peer(&mut self, name: &str) -> &mut Peer {
        let at = self.0.iter().position(|peer| peer.name == name);
        let known = at.and_then(|at| self.0.remove(at));
        if self.0.len() == PEERS {
            self.0.pop_front();
        }
        let peer = known.unwrap_or_else(|| Peer {
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
    fn a_peers_links_ends_and_failures_are_counted() {
        let (mut history, start) = (History::default(), Instant::now());
        history.on_linked("wombat-2");
        history.on_ended("wombat-2", "it is done", start);
        history.on_failed_dial("wombat-2", "it was not heard", start);
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
            last_failure: event("it was not heard"),
        };
        assert_eq!(status, [expected]);
    }

    #[test]
    fn many_names_push_out_the_oldest_only() {
        let mut history = History::default();
        for n in 0..1000 {
            history.on_linked("friend");
            history.on_linked(&format!("stranger {n}"));
        }
        let status = history.status(Instant::now());
        assert_eq!(status.len(), PEERS);
        assert!(status.iter().any(|p| p.peer == "friend" && p.links == 1000));
    }
}
