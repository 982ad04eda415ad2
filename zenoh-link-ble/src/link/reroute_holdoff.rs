//! Decides how long a new link waits after another link has ended, before it is handed to Zenoh. This is plain logic: the
//! caller reports what happens and does the waiting.
//!
//! Zenoh's router computes its routes at most every 100 ms, and then declares its subscriptions to the neighbours that are
//! new since the last computation. It identifies neighbours by their index in a table, and the index of a removed neighbour
//! is given to the next one. A neighbour that is added before the removal of its predecessor was computed does not count as
//! new and receives no declarations: its link stays up and carries no message until it ends. A new link therefore waits
//! until Zenoh has released all ended links and has computed its routes since.
use std::{
    collections::HashMap,
    time::{Duration, Instant},
};

use crate::link::number::LinkNumber;

/// Time after which Zenoh has computed its routes: its interval of 100 ms, and twice that as a margin for a busy processor.
const HOLDOFF: Duration = Duration::from_millis(300);

/// The condition that a new link has to wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holdoff {
    /// Until Zenoh has released a link that has ended.
    UntilReleased,
    /// Until that time, because Zenoh has released a link recently.
    Until(Instant),
    /// Nothing: the link can be handed to Zenoh.
    Elapsed,
}

/// Keeps track of the links of a node that Zenoh holds or has released recently.
#[derive(Debug, Default)]
pub(crate) struct RerouteHoldoff {
    links: HashMap<LinkNumber, LinkPhase>,
}

#[derive(Clone, Copy, Debug)]
enum LinkPhase {
    Open,
    Ended,
    Released(Instant),
}

impl RerouteHoldoff {
    /// Returns what a new link has to wait for at that time.
    pub(crate) fn at(&self, now: Instant) -> Holdoff {
        let mut last = None;
        for link in self.links.values() {
            match *link {
                LinkPhase::Open => {}
                LinkPhase::Ended => return Holdoff::UntilReleased,
                LinkPhase::Released(at) => last = last.max(Some(at)),
            }
        }
        match last.map(|at| at + HOLDOFF) {
            Some(end) if now < end => Holdoff::Until(end),
            _ => Holdoff::Elapsed,
        }
    }

    /// Records that a link is handed to Zenoh.
    pub(crate) fn on_handed_over(&mut self, link: LinkNumber) {
        self.links.insert(link, LinkPhase::Open);
    }

    /// Records that a link has ended.
    pub(crate) fn on_ended(&mut self, link: LinkNumber) {
        if let Some(state @ LinkPhase::Open) = self.links.get_mut(&link) {
            *state = LinkPhase::Ended;
        }
    }

    /// Records that Zenoh has released a link.
    pub(crate) fn on_released(&mut self, link: LinkNumber, now: Instant) {
        let state = self.links.get_mut(&link);
        if let Some(state @ (LinkPhase::Open | LinkPhase::Ended)) = state {
            *state = LinkPhase::Released(now);
        }
        let is_relevant =
            |state: &LinkPhase| !matches!(state, LinkPhase::Released(at) if now >= *at + HOLDOFF);
        self.links.retain(|_, state| is_relevant(state));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: LinkNumber = LinkNumber(1);
    const TWO: LinkNumber = LinkNumber(2);

    /// Returns the state after these links were handed to Zenoh, and the current time.
    fn holdoff_with(links: &[LinkNumber]) -> (RerouteHoldoff, Instant) {
        let mut holdoff = RerouteHoldoff::default();
        for link in links {
            holdoff.on_handed_over(*link);
        }
        (holdoff, Instant::now())
    }

    #[test]
    fn link_waits_until_zenoh_released_an_ended_one_and_computed_its_routes() {
        let (mut holdoff, start) = holdoff_with(&[ONE]);
        assert_eq!(holdoff.at(start), Holdoff::Elapsed);
        holdoff.on_ended(ONE);
        assert_eq!(holdoff.at(start), Holdoff::UntilReleased);
        holdoff.on_released(ONE, start);
        assert_eq!(holdoff.at(start), Holdoff::Until(start + HOLDOFF));
        assert_eq!(holdoff.at(start + HOLDOFF), Holdoff::Elapsed);
    }

    #[test]
    fn last_released_link_determines_the_holdoff() {
        let (mut holdoff, start) = holdoff_with(&[ONE, TWO]);
        let later = start + Duration::from_millis(20);
        holdoff.on_released(TWO, later);
        holdoff.on_released(ONE, start);
        assert_eq!(holdoff.at(later), Holdoff::Until(later + HOLDOFF));
    }

    #[test]
    fn link_is_released_once() {
        let (mut holdoff, start) = holdoff_with(&[ONE]);
        holdoff.on_released(ONE, start);
        holdoff.on_ended(ONE);
        holdoff.on_released(ONE, start + HOLDOFF / 2);
        assert_eq!(holdoff.at(start + HOLDOFF), Holdoff::Elapsed);
    }

    #[test]
    fn link_that_zenoh_never_had_causes_no_holdoff() {
        let (mut holdoff, start) = holdoff_with(&[]);
        holdoff.on_ended(ONE);
        holdoff.on_released(ONE, start);
        assert_eq!(holdoff.at(start), Holdoff::Elapsed);
    }

    #[test]
    fn irrelevant_links_are_forgotten() {
        let (mut holdoff, start) = holdoff_with(&[ONE, TWO]);
        holdoff.on_released(ONE, start);
        holdoff.on_released(TWO, start + HOLDOFF);
        assert_eq!(holdoff.links.len(), 1);
    }
}
