//! Owns what the air does next, and when somebody must look.
use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use super::{Air, ConnectionId};
use crate::radio::sim::{adapter::Adapter, air::AdapterId, message::RequestId, options::LINGER};

/// What the air does next. Of what is due at the same time, the first of this list comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Due {
    ExchangeEnd(ConnectionId),
    GiveUp(ConnectionId, usize),
    Anchor(ConnectionId),
    Advertise(AdapterId, RequestId),
    LingerEnd(ConnectionId),
}

/// All that is due, in order. Whoever sets a time, or brings it forward, puts it in ([`Air::plan`]); what was put off, or
/// is off, is found out when its turn comes.
#[derive(Debug, Default)]
pub(super) struct Agenda {
    in_order: BTreeSet<(Duration, Due)>,
    times: BTreeMap<Due, Duration>,
}

impl Agenda {
    fn put(&mut self, due: Due, at: Option<Duration>) {
        let before = match at {
            Some(at) => self.times.insert(due, at),
            None => self.times.remove(&due),
        };
        if let Some(before) = before {
            self.in_order.remove(&(before, due));
        }
        self.in_order.extend(at.map(|at| (at, due)));
    }
}

impl Air {
    /// Puts in when that is due now.
    pub(super) fn plan(&mut self, due: Due) {
        let at = self.time_of(due);
        self.agenda.put(due, at);
    }

    /// What is next, and when.
    pub(super) fn next_due(&mut self) -> Option<(Duration, Due)> {
        loop {
            let (at, due) = *self.agenda.in_order.first()?;
            if self.time_of(due) == Some(at) {
                return Some((at, due));
            }
            self.plan(due);
        }
    }

    /// When `poll` is due at the latest: when something may happen that an adapter is to be told. What happens until then
    /// without a word (events of a connection with nothing to send, advertisements that nobody listens to) is made up for.
    pub fn next_wakeup(&self) -> Option<Duration> {
        let connections = self.connections.iter().flat_map(|(id, connection)| {
            let is_quiet = connection.is_quiet();
            let events =
                [Due::ExchangeEnd(*id), Due::Anchor(*id)].map(|due| (!is_quiet).then_some(due));
            let ends = [0, 1].map(|side| Some(Due::GiveUp(*id, side)));
            events.into_iter().chain(ends).flatten()
        });
        let is_listened_to = self.adapters.values().any(Adapter::listens);
        let advertisers = self.adapters.iter().filter(|_| is_listened_to);
        let advertisements = advertisers.flat_map(|(id, adapter)| {
            let requests = adapter.advertisements.keys();
            requests.map(|request| Due::Advertise(*id, *request))
        });
        let can_be_told = connections.chain(advertisements);
        can_be_told.filter_map(|due| self.time_of(due)).min()
    }

    fn time_of(&self, due: Due) -> Option<Duration> {
        match due {
            Due::ExchangeEnd(id) => {
                let exchange = self.connections.get(&id)?.exchange.as_ref();
                exchange.map(|exchange| exchange.ends_at)
            }
            Due::GiveUp(id, side) => {
                let connection = self.connections.get(&id)?;
                let is_up = connection.sides[side].is_up;
                is_up.then(|| connection.gives_up_at(side, &self.options))
            }
            Due::Anchor(id) => self.connections.get(&id).map(|c| c.anchor),
            Due::Advertise(adapter, request) => {
                let adapter = self.adapters.get(&adapter)?;
                adapter.advertisements.get(&request).map(|a| a.next)
            }
            Due::LingerEnd(id) => {
                let idle_since = self.connections.get(&id)?.idle_since;
                idle_since.map(|since| since + LINGER)
            }
        }
    }
}
