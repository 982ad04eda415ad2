//! Decides whether a request that ended without a reply may have been carried out.
use std::sync::atomic::{AtomicU32, Ordering};

/// Whether somebody serves a key, as Zenoh reports of a querier, and how often that has changed. Zenoh reports a change a moment
/// after it has taken effect.
#[derive(Debug, Default)]
pub struct Served(AtomicU32);

/// The state of [`Served`] when a request was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent {
    changes: u32,
    has_appeared: bool,
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

    /// Returns the state for a request that will be sent now.
    pub fn sending(&self) -> Sent {
        Sent {
            changes: self.0.load(Ordering::Relaxed),
            has_appeared: false,
        }
    }

    /// Returns why a request ended without a reply. `at_once`: Zenoh ended it on the thread that has sent it, as it does with a request
    /// that matches nothing.
    pub fn unanswered(&self, sent: Sent, at_once: bool) -> Unanswered {
        let has_changed = self.0.load(Ordering::Relaxed) != sent.changes;
        let has_appeared = !at_once && (has_changed || sent.has_appeared);
        match is_odd(sent.changes) || has_appeared {
            true => Unanswered::Interrupted,
            false => Unanswered::NoService,
        }
    }
}

impl Sent {
    /// Returns whether Zenoh is to be asked for the state of now, when it has taken the request: a service may have appeared that it
    /// has not reported.
    pub fn must_ask(&self) -> bool {
        !is_odd(self.changes)
    }

    /// Handles Zenoh's answer.
    pub fn on_answer(&mut self, is_served: bool) {
        self.has_appeared = is_served;
    }
}

/// An odd number of changes: it is served.
fn is_odd(changes: u32) -> bool {
    changes % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(served: &Served, is_served: bool) -> Sent {
        let mut sent = served.sending();
        sent.on_answer(is_served);
        sent
    }

    #[test]
    fn request_that_nobody_received_was_not_carried_out() {
        let served = Served::default();
        served.on_matching(false);
        let first = sent(&served, false);
        assert_eq!(served.unanswered(first, false), Unanswered::NoService);
        // It has reached nobody, although a service appeared a moment later.
        served.on_matching(true);
        assert_eq!(served.unanswered(first, true), Unanswered::NoService);
    }

    #[test]
    fn request_to_a_service_that_was_known_may_have_been_carried_out_however_fast_it_ended() {
        let served = Served::default();
        served.on_matching(true);
        let known = sent(&served, true);
        served.on_matching(false);
        assert_eq!(served.unanswered(known, true), Unanswered::Interrupted);
    }

    #[test]
    fn request_that_may_have_been_received_may_have_been_carried_out() {
        let served = Served::default();
        // Zenoh has not reported the service yet, and never does, as it has ended before.
        let before = sent(&served, true);
        assert_eq!(served.unanswered(before, false), Unanswered::Interrupted);
        let first = sent(&served, false);
        served.on_matching(true);
        let second = sent(&served, false);
        served.on_matching(true);
        served.on_matching(false);
        for sent in [first, second] {
            assert_eq!(served.unanswered(sent, false), Unanswered::Interrupted);
        }
        let last = sent(&served, false);
        assert_eq!(served.unanswered(last, false), Unanswered::NoService);
    }
}
