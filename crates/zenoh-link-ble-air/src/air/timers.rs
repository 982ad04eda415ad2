//! Keeps track of the timers of the air: what happens next, and when the model must be polled.
use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use super::{advertising_channel::event_duration, Air, ConnectionId};
use crate::{adapter::Adapter, id::AdapterId, message::RequestId};

/// Timers of the air. Timers that expire at the same time are handled in the order of this list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Timer {
    ExchangeEnd(ConnectionId),
    SupervisionTimeout(ConnectionId, usize),
    Anchor(ConnectionId),
    Advertise(AdapterId, RequestId),
    AdvertisingEnd(AdapterId, RequestId),
}

/// All timers in order of their expiry. Code that sets a timer or brings it forward calls [`Air::schedule`]. A timer
/// that was postponed or cancelled is corrected when its old expiry is reached.
#[derive(Debug, Default)]
pub(super) struct TimerQueue {
    by_time: BTreeSet<(Duration, Timer)>,
    by_timer: BTreeMap<Timer, Duration>,
}

impl TimerQueue {
    fn set(&mut self, timer: Timer, at: Option<Duration>) {
        let before = match at {
            Some(at) => self.by_timer.insert(timer, at),
            None => self.by_timer.remove(&timer),
        };
        if let Some(before) = before {
            self.by_time.remove(&(before, timer));
        }
        self.by_time.extend(at.map(|at| (at, timer)));
    }

    /// Returns the expiry of the first timer that is neither the start of a connection event nor a supervision timeout.
    pub(super) fn next_besides_events(&self) -> Option<Duration> {
        let is_event =
            |timer: &Timer| matches!(timer, Timer::Anchor(_) | Timer::SupervisionTimeout(..));
        let mut timers = self.by_time.iter();
        timers
            .find(|(_, timer)| !is_event(timer))
            .map(|(at, _)| *at)
    }
}

impl Air {
    /// Updates the queue with the current expiry of a timer.
    pub(super) fn schedule(&mut self, timer: Timer) {
        let at = self.timer_expiry(timer);
        self.timers.set(timer, at);
    }

    /// Returns the next timer and its expiry.
    pub(super) fn next_timer(&mut self) -> Option<(Duration, Timer)> {
        loop {
            let (at, timer) = *self.timers.by_time.first()?;
            if self.timer_expiry(timer) == Some(at) {
                return Some((at, timer));
            }
            self.schedule(timer);
        }
    }

    /// Returns the latest time at which `poll` must be called: the next time at which an adapter may receive an event.
    /// `poll` catches up on everything without an event before that time (events of idle connections, advertisements
    /// that no adapter receives).
    pub fn next_wakeup(&self) -> Option<Duration> {
        let connections = self.connections.iter().flat_map(|(id, connection)| {
            let is_quiet = connection.is_quiet();
            let events = [Timer::ExchangeEnd(*id), Timer::Anchor(*id)]
                .map(|timer| (!is_quiet).then_some(timer));
            let ends = [0, 1].map(|side| Some(Timer::SupervisionTimeout(*id, side)));
            events.into_iter().chain(ends).flatten()
        });
        let is_anyone_receiving = self.adapters.values().any(Adapter::receives_advertisements);
        let advertisers = self.adapters.iter().filter(|_| is_anyone_receiving);
        let advertisements = advertisers.flat_map(|(id, adapter)| {
            let requests = adapter.advertisements.keys();
            requests.flat_map(|request| {
                let (id, request) = (*id, *request);
                [
                    Timer::Advertise(id, request),
                    Timer::AdvertisingEnd(id, request),
                ]
            })
        });
        let timers = connections.chain(advertisements);
        timers.filter_map(|timer| self.timer_expiry(timer)).min()
    }

    fn timer_expiry(&self, timer: Timer) -> Option<Duration> {
        match timer {
            Timer::ExchangeEnd(id) => {
                let exchange = self.connections.get(&id)?.exchange.as_ref();
                exchange.map(|exchange| exchange.ends_at)
            }
            Timer::SupervisionTimeout(id, side) => {
                let connection = self.connections.get(&id)?;
                let is_up = connection.sides[side].is_up;
                is_up.then(|| connection.supervision_ends_at(side, &self.options))
            }
            Timer::Anchor(id) => self.connections.get(&id).map(|c| c.anchor),
            Timer::Advertise(adapter, request) => {
                let adapter = self.adapters.get(&adapter)?;
                adapter.advertisements.get(&request).map(|a| a.next)
            }
            Timer::AdvertisingEnd(adapter, request) => {
                let adapter = self.adapters.get(&adapter)?;
                let start = adapter.advertisements.get(&request)?.event?;
                Some(start + event_duration())
            }
        }
    }
}
