//! Owns the simulated air: who is on it, what is due next, and the faults a test can inject. It does no I/O and has no
//! clock: it is told the time, which counts from its start.
//!
//! How it does what is due is in its parts: [`commands`] (what adapters ask for), [`advertising`] (advertisements and
//! the connections that come of them), [`exchange`] (packets of connections), [`delivery`] (what arrives).
mod advertising;
mod commands;
mod delivery;
mod exchange;
mod status;

use std::{collections::BTreeMap, time::Duration};

use serde::{Deserialize, Serialize};

use super::{
    adapter::{check_name, Adapter, AdapterNameError},
    condition::{Condition, Figures},
    connection::Connection,
    dice::Dice,
    message::{ChannelId, Event, RequestId},
    options::{AirOptions, LINGER},
};
use crate::radio::AdapterState;

pub use self::status::{AdapterStatus, AirStatus, LinkStatus};

/// An adapter while it is attached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct AdapterId(pub u32);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct ConnectionId(u32);

/// Why an adapter cannot be attached.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum AttachError {
    /// The name is none of a simulated adapter.
    #[error(transparent)]
    Name(#[from] AdapterNameError),
    /// Somebody has attached an adapter of that name.
    #[error("{0} is attached by another program already: choose another name")]
    InUse(String),
}

/// There is no adapter of that name on the air.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("there is no adapter {0} on the air: `rect air status` lists them")]
pub struct NoSuchAdapter(pub String);

/// The simulated air.
#[derive(Debug)]
pub struct Air {
    options: AirOptions,
    figures: Figures,
    dice: Dice,
    now: Duration,
    adapters: BTreeMap<AdapterId, Adapter>,
    connections: BTreeMap<ConnectionId, Connection>,
    homes: BTreeMap<ChannelId, ConnectionId>,
    last_adapter: u32,
    last_connection: u32,
    last_channel: u64,
    is_cut: bool,
    cuts: Vec<(String, String)>,
    events: Vec<Happened>,
}

/// An event, with whom it is for and when it happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Happened {
    /// When.
    pub at: Duration,
    /// For whom.
    pub adapter: AdapterId,
    /// What.
    pub event: Event,
}

/// What the air does next. Of what is due at the same time, the first of this list comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Due {
    ExchangeEnd(ConnectionId),
    GiveUp(ConnectionId, usize),
    Anchor(ConnectionId),
    Advertise(AdapterId, RequestId),
    LingerEnd(ConnectionId),
}

impl Air {
    /// An empty air. Options that no link could have are brought to the nearest that one could.
    pub fn new(options: AirOptions) -> Self {
        let options = options.clamped();
        Self {
            figures: options.condition.figures(),
            dice: Dice::new(options.seed),
            options,
            now: Duration::ZERO,
            adapters: BTreeMap::new(),
            connections: BTreeMap::new(),
            homes: BTreeMap::new(),
            last_adapter: 0,
            last_connection: 0,
            last_channel: 0,
            is_cut: false,
            cuts: Vec::new(),
            events: Vec::new(),
        }
    }

    /// Does all that is due until `now`.
    pub fn poll(&mut self, now: Duration) {
        while let Some((at, due)) = self.next_due().filter(|(at, _)| *at <= now) {
            self.now = self.now.max(at);
            match due {
                Due::ExchangeEnd(id) => self.finish_exchange(id),
                Due::GiveUp(id, side) => self.drop_side(id, side),
                Due::Anchor(id) => self.on_anchor(id),
                Due::Advertise(adapter, request) => self.on_advertise(adapter, request),
                Due::LingerEnd(id) => {
                    self.connections.remove(&id);
                }
            }
        }
        self.now = self.now.max(now);
    }

    /// When `poll` has something to do.
    pub fn next_wakeup(&self) -> Option<Duration> {
        self.next_due().map(|(at, _)| at)
    }

    /// What has happened since the last call, in order.
    pub fn drain(&mut self) -> Vec<Happened> {
        std::mem::take(&mut self.events)
    }

    /// Brings an adapter on the air, powered on.
    pub fn attach(&mut self, name: &str, now: Duration) -> Result<AdapterId, AttachError> {
        self.poll(now);
        check_name(name)?;
        if self.find(name).is_ok() {
            return Err(AttachError::InUse(name.to_owned()));
        }
        self.last_adapter += 1;
        let id = AdapterId(self.last_adapter);
        self.adapters.insert(id, Adapter::new(name));
        Ok(id)
    }

    /// Takes an adapter off the air; its peers are told, as when a program ends.
    pub fn detach(&mut self, id: AdapterId, now: Duration) {
        self.poll(now);
        self.leave(id, true);
        self.adapters.remove(&id);
    }

    /// Switches an adapter on (also one that was removed) or off. Its peers are told, as BlueZ does.
    pub fn power(&mut self, name: &str, on: bool, now: Duration) -> Result<(), NoSuchAdapter> {
        let state = if on {
            AdapterState::On
        } else {
            AdapterState::Off
        };
        self.set_state(name, state, now)
    }

    /// Pulls an adapter out; its peers find out by hearing nothing.
    pub fn remove(&mut self, name: &str, now: Duration) -> Result<(), NoSuchAdapter> {
        self.set_state(name, AdapterState::Missing, now)
    }

    fn set_state(
        &mut self,
        name: &str,
        state: AdapterState,
        now: Duration,
    ) -> Result<(), NoSuchAdapter> {
        self.poll(now);
        let id = self.find(name)?;
        let Some(adapter) = self.adapters.get_mut(&id) else {
            return Ok(());
        };
        if adapter.state == state {
            return Ok(());
        }
        adapter.state = state;
        if state != AdapterState::On {
            adapter.stop();
            self.leave(id, state == AdapterState::Off);
        }
        self.tell(id, Event::State(state));
        Ok(())
    }

    /// Nobody hears anybody any more.
    pub fn cut(&mut self, now: Duration) {
        self.poll(now);
        self.is_cut = true;
    }

    /// These two do not hear each other any more. They need not be on the air yet.
    pub fn cut_between(&mut self, a: &str, b: &str, now: Duration) {
        self.poll(now);
        self.cuts.push((a.to_owned(), b.to_owned()));
    }

    /// Everybody hears everybody again.
    pub fn restore(&mut self, now: Duration) {
        self.poll(now);
        self.is_cut = false;
        self.cuts.clear();
    }

    /// Changes how good the air is.
    pub fn set_condition(&mut self, condition: Condition, now: Duration) {
        self.poll(now);
        self.options.condition = condition;
        self.figures = condition.figures();
    }

    fn next_due(&self) -> Option<(Duration, Due)> {
        let connections = self.connections.iter().flat_map(|(id, connection)| {
            let exchange = connection
                .exchange
                .as_ref()
                .map(|exchange| (exchange.ends_at, Due::ExchangeEnd(*id)));
            let linger = connection
                .idle_since
                .map(|since| (since + LINGER, Due::LingerEnd(*id)));
            let give_up = [0, 1].into_iter().filter_map(|side| {
                let at = connection.gives_up_at(side, &self.options);
                connection.sides[side]
                    .is_up
                    .then_some((at, Due::GiveUp(*id, side)))
            });
            let anchor = (connection.anchor, Due::Anchor(*id));
            exchange
                .into_iter()
                .chain(linger)
                .chain(give_up)
                .chain([anchor])
        });
        let advertisements = self.adapters.iter().flat_map(|(id, adapter)| {
            adapter
                .advertisements
                .iter()
                .map(|(request, advertising)| (advertising.next, Due::Advertise(*id, *request)))
        });
        connections.chain(advertisements).min()
    }

    fn find(&self, name: &str) -> Result<AdapterId, NoSuchAdapter> {
        self.adapters
            .iter()
            .find(|(_, adapter)| adapter.name == name)
            .map(|(id, _)| *id)
            .ok_or_else(|| NoSuchAdapter(name.to_owned()))
    }

    /// Whether two adapters can hear each other at all.
    fn is_in_range(&self, a: AdapterId, b: AdapterId) -> bool {
        let (Some(a), Some(b)) = (self.adapters.get(&a), self.adapters.get(&b)) else {
            return false;
        };
        let is_between = |(x, y): &(String, String)| {
            (*x == a.name && *y == b.name) || (*x == b.name && *y == a.name)
        };
        a.is_on() && b.is_on() && !self.is_cut && !self.cuts.iter().any(is_between)
    }

    fn tell(&mut self, adapter: AdapterId, event: Event) {
        self.events.push(Happened {
            at: self.now,
            adapter,
            event,
        });
    }
}

#[cfg(test)]
mod tests;
