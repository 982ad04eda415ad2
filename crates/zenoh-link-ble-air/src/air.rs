//! Models the simulated air: the attached adapters, the next timer, and the faults that a test can inject. The model
//! does no I/O and has no clock. Every call passes the time since the model's start.
//!
//! [`timers`] determines what happens next. The other parts implement it: [`commands`] (requests of adapters),
//! [`advertising`] and [`advertising_channel`] (advertisements and the connections that result from them), [`schedule`] (which connection gets a radio), [`interval`],
//! [`exchange`] (packets of connections), [`delivery`] (received packets), and [`idle`] (a shortcut for idle connections).
mod advertising;
mod advertising_channel;
mod commands;
mod delivery;
mod exchange;
mod idle;
mod interval;
mod schedule;
mod status;
mod timers;

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};
use zenoh_link_ble_radio::AdapterState;

use super::{
    adapter::{check_name, Adapter, AdapterNameError},
    clock::Clock,
    condition::{Condition, Figures},
    connection::Connection,
    id::{AdapterId, ConnectionId},
    message::{ChannelId, Event},
    options::AirOptions,
    rng::SimRng,
};

use self::advertising_channel::{AdvertisingChannel, Collisions};
pub use self::status::{AdapterStatus, AirStatus, LinkStatus};
use self::timers::{Timer, TimerQueue};

/// Reasons why an adapter cannot be attached.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum AttachError {
    /// The name is not a valid name of a simulated adapter.
    #[error(transparent)]
    Name(#[from] AdapterNameError),
    /// An adapter of that name is already attached.
    #[error("{0} is already attached by another program: choose another name")]
    InUse(String),
}

/// No adapter of that name is attached to the air.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("there is no adapter {0} on the air: `rect air status` lists them")]
pub struct NoSuchAdapter(pub String);

/// The simulated air.
#[derive(Debug)]
pub struct Air {
    options: AirOptions,
    figures: Figures,
    rng: SimRng,
    now: Duration,
    adapters: BTreeMap<AdapterId, Adapter>,
    connections: BTreeMap<ConnectionId, Connection>,
    channel_connections: BTreeMap<ChannelId, ConnectionId>,
    last_adapter: u32,
    last_connection: u32,
    last_channel: u64,
    is_cut: bool,
    /// Number of packets that still arrive before all radio contact is cut.
    cut_after: Option<u64>,
    /// Pairs of adapters that are out of range of each other, by name, stored in both directions.
    cuts: BTreeMap<String, BTreeSet<String>>,
    advertising_channel: AdvertisingChannel,
    collisions: Collisions,
    timers: TimerQueue,
    events: Vec<TimedEvent>,
}

/// An event with its time and the adapter it is for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TimedEvent {
    /// Time of the event, since the start of the air.
    pub at: Duration,
    /// Adapter that receives the event.
    pub adapter: AdapterId,
    /// The event.
    pub event: Event,
}

impl Air {
    /// Returns an air without adapters. Options outside the range of Bluetooth are clamped to it.
    pub fn new(options: AirOptions) -> Self {
        let options = options.clamped();
        Self {
            figures: options.condition.figures(),
            rng: SimRng::new(options.seed),
            options,
            now: Duration::ZERO,
            adapters: BTreeMap::new(),
            connections: BTreeMap::new(),
            channel_connections: BTreeMap::new(),
            last_adapter: 0,
            last_connection: 0,
            last_channel: 0,
            is_cut: false,
            cut_after: None,
            cuts: BTreeMap::new(),
            advertising_channel: AdvertisingChannel::default(),
            collisions: Collisions::default(),
            timers: TimerQueue::default(),
            events: Vec::new(),
        }
    }

    /// Handles all timers that expire until `now`.
    pub fn poll(&mut self, now: Duration) {
        while let Some((at, timer)) = self.next_timer().filter(|(at, _)| *at <= now) {
            self.now = self.now.max(at);
            if matches!(timer, Timer::Anchor(_)) && self.advance_idle(now) {
                continue;
            }
            match timer {
                Timer::ExchangeEnd(id) => self.finish_exchange(id),
                Timer::SupervisionTimeout(id, side) => self.drop_side(id, side),
                Timer::Anchor(id) => self.on_anchor(id),
                Timer::Advertise(adapter, request) => self.on_advertise(adapter, request),
                Timer::AdvertisingEnd(adapter, request) => {
                    self.on_advertising_end(adapter, request);
                }
            }
        }
        self.now = self.now.max(now);
    }

    /// Returns the events since the last call, in order.
    pub fn drain(&mut self) -> Vec<TimedEvent> {
        std::mem::take(&mut self.events)
    }

    /// Attaches an adapter to the air, powered on.
    pub fn attach(&mut self, name: &str, now: Duration) -> Result<AdapterId, AttachError> {
        self.poll(now);
        check_name(name)?;
        if self.find(name).is_ok() {
            return Err(AttachError::InUse(name.to_owned()));
        }
        self.last_adapter += 1;
        let id = AdapterId(self.last_adapter);
        let (seed, drift) = (self.options.seed, self.options.max_clock_drift_ppm);
        let adapter = Adapter::new(name, Clock::of(name, seed, drift));
        self.adapters.insert(id, adapter);
        Ok(id)
    }

    /// Detaches an adapter from the air. Its peers receive a termination, as when a program ends.
    pub fn detach(&mut self, id: AdapterId, now: Duration) {
        self.poll(now);
        self.leave_connections(id, true);
        self.adapters.remove(&id);
    }

    /// Switches an adapter on (also a removed one) or off. Its peers receive a termination, as with BlueZ.
    pub fn power(&mut self, name: &str, on: bool, now: Duration) -> Result<(), NoSuchAdapter> {
        let state = if on {
            AdapterState::On
        } else {
            AdapterState::Off
        };
        self.set_state(name, state, now)
    }

    /// Removes an adapter without notice, as when a dongle is unplugged. Its peers detect it by their supervision
    /// timeout.
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
            self.leave_connections(id, state == AdapterState::Off);
        }
        self.emit(id, Event::State(state));
        Ok(())
    }

    /// Cuts the radio contact between all adapters.
    pub fn cut(&mut self, now: Duration) {
        self.poll(now);
        self.is_cut = true;
    }

    /// Cuts the radio contact as [`Air::cut`] does, once `packets` more packets with data have arrived (0:
    /// immediately). Each packet counts once, whether it carries a part of an SDU or an L2CAP command. The response in
    /// the same exchange is lost.
    pub fn cut_after(&mut self, packets: u64, now: Duration) {
        self.poll(now);
        self.is_cut |= packets == 0;
        self.cut_after = Some(packets).filter(|packets| *packets > 0);
    }

    /// Cuts the radio contact between two adapters. They need not be attached yet.
    pub fn cut_between(&mut self, a: &str, b: &str, now: Duration) {
        self.poll(now);
        for (one, other) in [(a, b), (b, a)] {
            let blocked = self.cuts.entry(one.to_owned()).or_default();
            blocked.insert(other.to_owned());
        }
    }

    /// Restores the radio contact between all adapters.
    pub fn restore(&mut self, now: Duration) {
        self.poll(now);
        self.is_cut = false;
        self.cut_after = None;
        self.cuts.clear();
    }

    /// Changes the radio condition.
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

    /// Returns whether two adapters are on and in range of each other.
    fn is_in_range(&self, a: AdapterId, b: AdapterId) -> bool {
        let (Some(a), Some(b)) = (self.adapters.get(&a), self.adapters.get(&b)) else {
            return false;
        };
        a.is_on() && b.is_on() && !self.is_cut && !self.is_cut_between(&a.name, &b.name)
    }

    /// Returns whether the contact between two adapters was cut, whether or not they are attached and on.
    fn is_cut_between(&self, a: &str, b: &str) -> bool {
        self.cuts.get(a).is_some_and(|blocked| blocked.contains(b))
    }

    fn emit(&mut self, adapter: AdapterId, event: Event) {
        self.events.push(TimedEvent {
            at: self.now,
            adapter,
            event,
        });
    }
}

#[cfg(test)]
mod tests;
