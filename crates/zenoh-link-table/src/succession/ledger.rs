//! Decides when a new link may go on with Zenoh's handshake. This is plain logic: the caller reports what happens and does the
//! waiting.
use std::{
    collections::HashMap,
    sync::Arc,
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use zenoh_protocol::core::{WhatAmI, ZenohIdProto};

use super::ZenohPair;

/// Time after which Zenoh has computed its routes: its interval of 100 ms, and twice that as a margin for a busy processor.
///
/// Zenoh's router computes its routes at most every 100 ms, and then declares its subscriptions to the neighbours that are new
/// since the last computation. It identifies neighbours by their index in a table, and the index of a removed neighbour is given
/// to the next one. A neighbour that is added before the removal of another one was computed does not count as new, and
/// receives no declarations.
const HOLDOFF: Duration = Duration::from_millis(300);
/// How long a link may be silent until a new one shows that the peer has lost it, in tenths of the lease. A keep-alive arrives four
/// times within the lease.
const SILENCE_TENTHS: u32 = 3;
/// How long after the arrival of a new link something has to be received on an earlier one to show that the peer still has it.
/// Messages that were on the way arrive sooner.
const ALIVE_AFTER: Duration = Duration::from_secs(1);
/// How long Zenoh's tasks of a session that was closed may run on before it counts as released.
const CLOSED_GRACE: Duration = Duration::from_secs(1);

/// A link or a session that Zenoh holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct HoldId(u64);

/// When something was received on a link for the last time.
#[derive(Debug)]
pub(super) struct LastReceived(Mutex<Instant>);

impl LastReceived {
    pub(super) fn new(now: Instant) -> Self {
        Self(Mutex::new(now))
    }

    pub(super) fn set(&self, now: Instant) {
        *self.0.lock() = now;
    }

    pub(super) fn get(&self) -> Instant {
        *self.0.lock()
    }
}

/// The next step of a new link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// It goes on.
    Proceed,
    /// It waits until something changes or, if given, until that time.
    Wait(Option<Instant>),
    /// These links end first, because the peer has lost them.
    End(Vec<HoldId>),
}

#[derive(Debug)]
enum Held {
    Link {
        received: Arc<LastReceived>,
        silence: Duration,
        is_ended: bool,
    },
    Session {
        closed_at: Option<Instant>,
    },
}

/// A link that has not ended.
struct Working {
    id: HoldId,
    /// When something was received.
    received_at: Instant,
    /// When the link counts as silent.
    silent_at: Instant,
}

/// The links and sessions that Zenoh holds.
#[derive(Debug, Default)]
pub(super) struct Ledger {
    last: u64,
    held: HashMap<HoldId, (ZenohPair, Held)>,
    /// When a session with another router was released for the last time, by the own identifier.
    rerouted: HashMap<ZenohIdProto, Instant>,
}

impl Ledger {
    /// Records that a link has completed its handshake. `lease` is that of the peer.
    pub(super) fn on_link(
        &mut self,
        pair: ZenohPair,
        received: Arc<LastReceived>,
        lease: Duration,
    ) -> HoldId {
        let link = Held::Link {
            received,
            silence: lease * SILENCE_TENTHS / 10,
            is_ended: false,
        };
        self.hold(pair, link)
    }

    /// Records that Zenoh has opened a session.
    pub(super) fn on_session(&mut self, pair: ZenohPair) -> HoldId {
        self.hold(pair, Held::Session { closed_at: None })
    }

    /// Records that a link has ended.
    pub(super) fn on_link_ended(&mut self, link: HoldId) {
        if let Some((_, Held::Link { is_ended, .. })) = self.held.get_mut(&link) {
            *is_ended = true;
        }
    }

    /// Records that Zenoh has closed a session. Returns the links of a successor that this has damaged.
    pub(super) fn on_session_closed(&mut self, session: HoldId, now: Instant) -> Vec<HoldId> {
        let Some((pair, Held::Session { closed_at })) = self.held.get_mut(&session) else {
            return Vec::new();
        };
        let (pair, is_repeated) = (*pair, closed_at.replace(now).is_some());
        let is_successor = |(id, (of, held)): (&HoldId, &(ZenohPair, Held))| {
            *id > session && is_same(of, &pair) && matches!(held, Held::Session { closed_at: None })
        };
        if is_repeated || self.held.iter().any(is_successor) {
            return self.working(&pair).map(|link| link.id).collect();
        }
        Vec::new()
    }

    /// Records that Zenoh has released a link or a session.
    pub(super) fn on_released(&mut self, id: HoldId, now: Instant) {
        if let Some((pair, _)) = self.held.remove(&id) {
            if is_between_routers(&pair) {
                self.rerouted.insert(pair.own.zid, now);
            }
        }
        self.rerouted.retain(|_, at| now < *at + HOLDOFF);
    }

    /// Returns what a new link does next that has waited since then.
    pub(super) fn step(&self, pair: ZenohPair, since: Instant, now: Instant) -> Step {
        if let Some(silent_at) = self.working(&pair).map(|link| link.silent_at).max() {
            // The peer uses the session: Zenoh decides whether it may have another link.
            let is_used = |link: Working| link.received_at >= since + ALIVE_AFTER;
            if self.working(&pair).any(is_used) {
                return Step::Proceed;
            }
            if now >= silent_at {
                return Step::End(self.working(&pair).map(|link| link.id).collect());
            }
            return Step::Wait(Some(silent_at));
        }
        let mut until = None;
        for (_, held) in self.held.values().filter(|(of, _)| is_same(of, &pair)) {
            match held {
                Held::Link { .. } | Held::Session { closed_at: None } => return Step::Wait(None),
                Held::Session {
                    closed_at: Some(at),
                } => until = until.max(Some(*at + CLOSED_GRACE)),
            }
        }
        if is_between_routers(&pair) {
            let rerouted = self.rerouted.get(&pair.own.zid);
            until = until.max(rerouted.map(|at| *at + HOLDOFF));
        }
        match until {
            Some(until) if now < until => Step::Wait(Some(until)),
            _ => Step::Proceed,
        }
    }

    /// Returns the links between the two that have not ended.
    fn working<'a>(&'a self, pair: &'a ZenohPair) -> impl Iterator<Item = Working> + 'a {
        self.held.iter().filter_map(|(id, (of, held))| match held {
            Held::Link {
                received,
                silence,
                is_ended: false,
            } if is_same(of, pair) => Some(Working {
                id: *id,
                received_at: received.get(),
                silent_at: received.get() + *silence,
            }),
            _ => None,
        })
    }

    fn hold(&mut self, pair: ZenohPair, held: Held) -> HoldId {
        self.last += 1;
        let id = HoldId(self.last);
        self.held.insert(id, (pair, held));
        id
    }
}

fn is_same(one: &ZenohPair, other: &ZenohPair) -> bool {
    (one.own.zid, one.peer.zid) == (other.own.zid, other.peer.zid)
}

fn is_between_routers(pair: &ZenohPair) -> bool {
    (pair.own.whatami, pair.peer.whatami) == (WhatAmI::Router, WhatAmI::Router)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::succession::ZenohNode;

    fn pair() -> ZenohPair {
        let router = || ZenohNode {
            zid: ZenohIdProto::rand(),
            whatami: WhatAmI::Router,
        };
        ZenohPair {
            own: router(),
            peer: router(),
        }
    }

    fn received(at: Instant) -> Arc<LastReceived> {
        Arc::new(LastReceived::new(at))
    }

    const MS: Duration = Duration::from_millis(1);
    const LEASE: Duration = Duration::from_secs(10);
    const SILENCE: Duration = Duration::from_secs(3);

    #[test]
    fn link_waits_until_zenoh_has_released_the_predecessor_and_computed_its_routes() {
        let (mut ledger, pair, start) = (Ledger::default(), pair(), Instant::now());
        assert_eq!(ledger.step(pair, start, start), Step::Proceed);
        let link = ledger.on_link(pair, received(start), LEASE);
        let session = ledger.on_session(pair);
        ledger.on_link_ended(link);
        assert_eq!(ledger.step(pair, start, start), Step::Wait(None));
        ledger.on_released(link, start);
        assert_eq!(ledger.step(pair, start, start), Step::Wait(None));
        ledger.on_released(session, start);
        let end = start + HOLDOFF;
        assert_eq!(ledger.step(pair, start, start), Step::Wait(Some(end)));
        assert_eq!(ledger.step(pair, start, end), Step::Proceed);
    }

    #[test]
    fn other_peers_wait_only_for_the_routes() {
        let (mut ledger, gone, start) = (Ledger::default(), pair(), Instant::now());
        let other = ZenohPair {
            own: gone.own,
            ..pair()
        };
        let link = ledger.on_link(gone, received(start), LEASE);
        ledger.on_link_ended(link);
        assert_eq!(ledger.step(other, start, start), Step::Proceed);
        ledger.on_released(link, start);
        let end = start + HOLDOFF;
        assert_eq!(ledger.step(other, start, start), Step::Wait(Some(end)));
        let program = ZenohPair {
            peer: ZenohNode {
                whatami: WhatAmI::Client,
                ..other.peer
            },
            ..other
        };
        assert_eq!(ledger.step(program, start, start), Step::Proceed);
    }

    #[test]
    fn silent_predecessor_ends_and_a_living_one_does_not() {
        let (mut ledger, pair, start) = (Ledger::default(), pair(), Instant::now());
        let last = received(start);
        let link = ledger.on_link(pair, Arc::clone(&last), LEASE);
        let end = start + SILENCE;
        assert_eq!(ledger.step(pair, start, start), Step::Wait(Some(end)));
        assert_eq!(ledger.step(pair, start, end), Step::End(vec![link]));
        // A message that was on the way does not show that the peer still has the link.
        last.set(start + ALIVE_AFTER - MS);
        let end = end + ALIVE_AFTER - MS;
        assert_eq!(ledger.step(pair, start, end - MS), Step::Wait(Some(end)));
        last.set(start + ALIVE_AFTER);
        assert_eq!(ledger.step(pair, start, end), Step::Proceed);
    }

    #[test]
    fn closed_session_is_waited_for_only_for_a_while() {
        let (mut ledger, pair, start) = (Ledger::default(), pair(), Instant::now());
        let session = ledger.on_session(pair);
        assert_eq!(ledger.step(pair, start, start), Step::Wait(None));
        assert!(ledger.on_session_closed(session, start).is_empty());
        let end = start + CLOSED_GRACE;
        assert_eq!(ledger.step(pair, start, start), Step::Wait(Some(end)));
        assert_eq!(ledger.step(pair, start, end), Step::Proceed);
    }

    #[test]
    fn session_that_is_closed_again_ends_the_links_of_its_successor() {
        let (mut ledger, pair, start) = (Ledger::default(), pair(), Instant::now());
        let session = ledger.on_session(pair);
        assert!(ledger.on_session_closed(session, start).is_empty());
        let successor = ledger.on_link(pair, received(start), LEASE);
        let _session = ledger.on_session(pair);
        assert_eq!(ledger.on_session_closed(session, start), [successor]);
        // A session that is closed although it has a successor damages it, too.
        let late = ledger.on_session(pair);
        let later = ledger.on_session(pair);
        assert_eq!(ledger.on_session_closed(late, start), [successor]);
        let newest = ledger.on_session_closed(later, start);
        assert!(newest.is_empty());
    }

    #[test]
    fn nothing_is_kept_of_what_was_released() {
        let (mut ledger, start) = (Ledger::default(), Instant::now());
        for n in 0..100 {
            let pair = pair();
            let link = ledger.on_link(pair, received(start), LEASE);
            let session = ledger.on_session(pair);
            ledger.on_released(link, start + HOLDOFF * n);
            ledger.on_released(session, start + HOLDOFF * n);
        }
        assert_eq!((ledger.held.len(), ledger.rerouted.len()), (0, 1));
    }
}
