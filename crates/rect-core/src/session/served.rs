//! Decides whether a request that ended without a reply may have been carried out.
use std::sync::atomic::{AtomicU32, Ordering};

/// Whether somebody serves a key, as Zenoh reports of a querier, and how often that has changed. Zenoh reports a change a moment
/// after it has taken effect.
#[derive(Debug, Default)]
pub struct Served(AtomicU32);

/// The changes of [`Served`] until a request is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unsent(u32);

/// The knowledge about a request that was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent {
    changes: u32,
    /// Whether somebody may have received it; `None` if that depends on a service that Zenoh has not reported yet.
    is_received: Option<bool>,
}

/// Why a request to one robot ended without a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unanswered {
    /// Nobody served the topic when the request was sent, so that nobody received it.
    NoService,
    /// Somebody served it, and may have carried it out: the link, the program or a router ended meanwhile.
    Interrupted,
}

impl Served {
    /// Handles a report of Zenoh. Reports of the same state are ignored.
    pub fn on_matching(&self, is_served: bool) {
        let changed = |changes| (is_odd(changes) != is_served).then(|| changes.wrapping_add(1));
        // It fails if nothing has changed.
        let _ = self
            .0
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, changed);
    }

    /// Returns whether somebody serves the key, as far as Zenoh has reported.
    pub fn is_served(&self) -> bool {
        is_odd(self.0.load(Ordering::Relaxed))
    }

    /// Returns the state before a request is sent.
    pub fn unsent(&self) -> Unsent {
        Unsent(self.0.load(Ordering::Relaxed))
    }

    /// Returns why a request ended without a reply.
    pub fn unanswered(&self, sent: Sent) -> Unanswered {
        let has_appeared = || self.0.load(Ordering::Relaxed) != sent.changes;
        match sent.is_received.unwrap_or_else(has_appeared) {
            true => Unanswered::Interrupted,
            false => Unanswered::NoService,
        }
    }
}

impl Unsent {
    /// Returns the state after Zenoh has taken the request. `at_once`: Zenoh has ended it on the thread that sends it, as it does with
    /// a request that matches nothing. `ask` asks Zenoh whether somebody serves the key now: a service may have appeared that it has not
    /// reported.
    pub fn taken(self, at_once: bool, ask: impl FnOnce() -> bool) -> Sent {
        let Self(changes) = self;
        let is_received = match (is_odd(changes), at_once) {
            (false, true) => Some(false),
            (false, false) => ask().then_some(true),
            (true, _) => Some(true),
        };
        Sent {
            changes,
            is_received,
        }
    }
}

/// An odd number of changes: it is served.
fn is_odd(changes: u32) -> bool {
    changes % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(served: &Served, at_once: bool, is_served: bool) -> Sent {
        served.unsent().taken(at_once, || is_served)
    }

    #[test]
    fn request_that_nobody_received_was_not_carried_out() {
        let served = Served::default();
        served.on_matching(false);
        let first = sent(&served, false, false);
        assert_eq!(served.unanswered(first), Unanswered::NoService);
        // It has reached nobody, although a service appeared a moment later.
        let at_once = sent(&served, true, true);
        served.on_matching(true);
        assert_eq!(served.unanswered(at_once), Unanswered::NoService);
    }

    #[test]
    fn request_to_a_service_that_was_known_may_have_been_carried_out_however_fast_it_ended() {
        let served = Served::default();
        assert!(!served.is_served());
        served.on_matching(true);
        assert!(served.is_served());
        let known = sent(&served, true, true);
        served.on_matching(false);
        assert_eq!(served.unanswered(known), Unanswered::Interrupted);
    }

    #[test]
    fn request_that_may_have_been_received_may_have_been_carried_out() {
        let served = Served::default();
        // Zenoh has not reported the service yet, and never does, as it has ended before.
        let before = sent(&served, false, true);
        assert_eq!(served.unanswered(before), Unanswered::Interrupted);
        let first = sent(&served, false, false);
        served.on_matching(true);
        let second = sent(&served, false, false);
        served.on_matching(true);
        served.on_matching(false);
        for sent in [first, second] {
            assert_eq!(served.unanswered(sent), Unanswered::Interrupted);
        }
        let last = sent(&served, false, false);
        assert_eq!(served.unanswered(last), Unanswered::NoService);
    }
}
