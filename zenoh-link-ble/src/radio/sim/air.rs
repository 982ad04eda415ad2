//! Owns the simulated air: who is on it, what is due next, and the faults a test can inject. It does no I/O and has no
//! clock: it is told the time, which counts from its start.
//!
//! What is due when is in [`due`], how it does it in the other parts: [`commands`] (what adapters ask for),
//! [`advertising`] (advertisements and the connections that come of them), [`exchange`] (packets of connections),
//! [`delivery`] (what arrives).
mod advertising;
mod commands;
mod delivery;
mod due;
mod exchange;
mod status;

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use serde::{Deserialize, Serialize};

use super::{
    adapter::{check_name, Adapter, AdapterNameError},
    condition::{Condition, Figures},
    connection::Connection,
    dice::Dice,
    message::{ChannelId, Event},
    options::AirOptions,
};
use crate::radio::AdapterState;

use self::due::{Agenda, Due};
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
    /// Packets that still arrive before everything is cut.
    cut_after: Option<u64>,
    /// Who does not hear whom, by name: both ways round.
    cuts: BTreeMap<String, BTreeSet<String>>,
    agenda: Agenda,
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
            cut_after: None,
            cuts: BTreeMap::new(),
            agenda: Agenda::default(),
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

    /// As [`Air::cut`], at the moment when so many more packets with data have arrived (0: now). A packet counts once,
    /// whatever it carries: a part of an SDU, or a command of L2CAP. The answer in the same exchange is not heard.
    pub fn cut_after(&mut self, packets: u64, now: Duration) {
        self.poll(now);
        self.is_cut |= packets == 0;
        self.cut_after = Some(packets).filter(|packets| *packets > 0);
    }

    /// These two do not hear each other any more. They need not be on the air yet.
    pub fn cut_between(&mut self, a: &str, b: &str, now: Duration) {
        self.poll(now);
        for (one, other) in [(a, b), (b, a)] {
            let deaf_to = self.cuts.entry(one.to_owned()).or_default();
            deaf_to.insert(other.to_owned());
        }
    }

    /// Everybody hears everybody again.
    pub fn restore(&mut self, now: Duration) {
        self.poll(now);
        self.is_cut = false;
        self.cut_after = None;
        self.cuts.clear();
    }

    /// Changes how good the air is.
    pub fn set_condition(&mut self, condition: Condition, now: Duration) {
        self.poll(now);
        self.options.condition = condition;
        self.figures = condition.figures();
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
        a.is_on() && b.is_on() && !self.is_cut && !self.is_cut_between(&a.name, &b.name)
    }

    /// Whether what one sends does not get to the other, wherever they are and whether they are on.
    fn is_cut_between(&self, a: &str, b: &str) -> bool {
        self.cuts.get(a).is_some_and(|deaf_to| deaf_to.contains(b))
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
