//! Owns the pause between a link's end and the next link. Plain logic: it is told what happens; nothing here waits.
//!
//! Zenoh's router computes its routes at most every 100 ms, and declares its subscriptions then to the neighbours that
//! were none the last time. It knows them by their places in a table, and a place left is taken by the next to come: a
//! neighbour that comes while another one, or itself a moment ago, is counted still is told nothing. Its link stays up
//! and carries no message until it ends. So a link waits until Zenoh has let the ended ones go and has computed since.
use std::{
    collections::HashMap,
    time::{Duration, Instant},
};

use crate::links::LinkNumber;

/// Zenoh's 100 ms, and twice as much again for a busy processor.
const COMPUTED: Duration = Duration::from_millis(300);

/// How long a link has to wait for those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pause {
    /// Zenoh holds one that has ended.
    UntilReleased,
    /// Zenoh let the last one go a moment ago.
    Until(Instant),
    /// None of them matters any more.
    Over,
}

/// What Zenoh knows of this node's links.
#[derive(Debug, Default)]
pub(crate) struct Pauses {
    links: HashMap<LinkNumber, Known>,
}

#[derive(Clone, Copy, Debug)]
enum Known {
    Linked,
    Ended,
    Released(Instant),
}

impl Pauses {
    /// What a new link waits for.
    pub(crate) fn now(&self, now: Instant) -> Pause {
        let mut last = None;
        for link in self.links.values() {
            match *link {
                Known::Linked => {}
                Known::Ended => return Pause::UntilReleased,
                Known::Released(at) => last = last.max(Some(at)),
            }
        }
        match last.map(|at| at + COMPUTED) {
            Some(end) if now < end => Pause::Until(end),
            _ => Pause::Over,
        }
    }

    /// Zenoh gets a link.
    pub(crate) fn on_given(&mut self, link: LinkNumber) {
        self.links.insert(link, Known::Linked);
    }

    /// A link is of no use any more.
    pub(crate) fn on_ended(&mut self, link: LinkNumber) {
        if let Some(known @ Known::Linked) = self.links.get_mut(&link) {
            *known = Known::Ended;
        }
    }

    /// Zenoh let a link go.
    pub(crate) fn on_released(&mut self, link: LinkNumber, now: Instant) {
        let known = self.links.get_mut(&link);
        if let Some(known @ (Known::Linked | Known::Ended)) = known {
            *known = Known::Released(now);
        }
        let matters =
            |known: &Known| !matches!(known, Known::Released(at) if now >= *at + COMPUTED);
        self.links.retain(|_, known| matters(known));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: LinkNumber = LinkNumber(1);
    const TWO: LinkNumber = LinkNumber(2);

    fn pauses_with(links: &[LinkNumber]) -> (Pauses, Instant) {
        let mut pauses = Pauses::default();
        for link in links {
            pauses.on_given(*link);
        }
        (pauses, Instant::now())
    }

    #[test]
    fn a_link_waits_until_zenoh_let_an_ended_one_go_and_computed_its_routes() {
        let (mut pauses, start) = pauses_with(&[ONE]);
        assert_eq!(pauses.now(start), Pause::Over);
        pauses.on_ended(ONE);
        assert_eq!(pauses.now(start), Pause::UntilReleased);
        pauses.on_released(ONE, start);
        assert_eq!(pauses.now(start), Pause::Until(start + COMPUTED));
        assert_eq!(pauses.now(start + COMPUTED), Pause::Over);
    }

    #[test]
    fn of_several_links_the_last_to_be_let_go_counts() {
        let (mut pauses, start) = pauses_with(&[ONE, TWO]);
        let later = start + Duration::from_millis(20);
        pauses.on_released(TWO, later);
        pauses.on_released(ONE, start);
        assert_eq!(pauses.now(later), Pause::Until(later + COMPUTED));
    }

    #[test]
    fn a_link_is_let_go_once() {
        let (mut pauses, start) = pauses_with(&[ONE]);
        pauses.on_released(ONE, start);
        pauses.on_ended(ONE);
        pauses.on_released(ONE, start + COMPUTED / 2);
        assert_eq!(pauses.now(start + COMPUTED), Pause::Over);
    }

    #[test]
    fn a_link_that_zenoh_never_had_keeps_nobody_waiting() {
        let (mut pauses, start) = pauses_with(&[]);
        pauses.on_ended(ONE);
        pauses.on_released(ONE, start);
        assert_eq!(pauses.now(start), Pause::Over);
    }

    #[test]
    fn nothing_is_kept_of_links_that_matter_no_more() {
        let (mut pauses, start) = pauses_with(&[ONE, TWO]);
        pauses.on_released(ONE, start);
        pauses.on_released(TWO, start + COMPUTED);
        assert_eq!(pauses.links.len(), 1);
    }
}
