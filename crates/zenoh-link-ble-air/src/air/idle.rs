//! Advances an air in which all connections are idle: the same events as one by one, without the data structures that only
//! data needs. A day with twenty idle connections then takes seconds.
use std::time::Duration;

use super::{timers::Timer, Air, ConnectionId};
use crate::{
    arbitration::{Arbitration, Claim},
    connection::{CENTRAL, PERIPHERAL},
    phy::Phy,
    rng::SimRng,
};

/// Shortest time that is advanced in this way. It is longer than the time between two polls of an air with traffic.
const MIN_SPAN: Duration = Duration::from_millis(250);

/// State of all idle connections. All times are in nanoseconds since the start of the air.
struct IdleAir {
    links: Vec<IdleLink>,
    radios: Vec<IdleRadio>,
    arbitration: Arbitration,
    event_loss: f64,
    packet_loss: f64,
    exchange: u64,
    supervision_timeout: u64,
    /// No event ends after this time.
    horizon: u64,
}

struct IdleLink {
    id: ConnectionId,
    /// Index of the radio of each side.
    radios: [usize; 2],
    anchor: u64,
    period: u64,
    interval: u64,
    last_received: [u64; 2],
    last_event: [u64; 2],
}

#[derive(Default)]
struct IdleRadio {
    /// The links of the radio, and its side of each.
    links: Vec<(usize, usize)>,
    busy_until: u64,
    exchanges: u32,
    packets: u64,
}

impl Air {
    /// Advances all connections until `until`, or until something happens that is not an event of an idle connection.
    /// Returns `false`, and changes nothing, unless all connections are idle for some time.
    pub(super) fn advance_idle(&mut self, until: Duration) -> bool {
        if until.saturating_sub(self.now) < MIN_SPAN {
            return false;
        }
        let until = self
            .timers
            .next_besides_events()
            .map_or(until, |at| at.min(until));
        if until.saturating_sub(self.now) < MIN_SPAN {
            return false;
        }
        let Some(mut idle) = self.idle_air(until) else {
            return false;
        };
        if !idle.run(&mut self.rng) {
            return false;
        }
        self.apply_idle(&idle);
        true
    }

    /// Returns the state of all connections, if all of them are idle.
    fn idle_air(&self, until: Duration) -> Option<IdleAir> {
        let ids: Vec<_> = self.adapters.keys().copied().collect();
        let mut radios: Vec<_> = ids.iter().map(|_| IdleRadio::default()).collect();
        let mut links = Vec::new();
        for (id, connection) in &self.connections {
            let [central, peripheral] = connection.sides.each_ref().map(|side| side.adapter);
            if !connection.is_idle() || !self.is_in_range(central, peripheral) {
                return None;
            }
            let radio = |side: usize| ids.binary_search(&connection.sides[side].adapter).ok();
            let radios_of_link = [radio(CENTRAL)?, radio(PERIPHERAL)?];
            for (side, radio) in radios_of_link.into_iter().enumerate() {
                radios[radio].links.push((links.len(), side));
            }
            let sides = &connection.sides;
            links.push(IdleLink {
                id: *id,
                radios: radios_of_link,
                anchor: nanos(connection.anchor),
                period: nanos(connection.period),
                interval: nanos(connection.interval),
                last_received: [
                    nanos(sides[0].last_received?),
                    nanos(sides[1].last_received?),
                ],
                last_event: [nanos(sides[0].last_event), nanos(sides[1].last_event)],
            });
        }
        Some(IdleAir {
            links,
            radios,
            arbitration: self.options.arbitration,
            event_loss: self.figures.event_loss,
            packet_loss: self.figures.packet_loss(0),
            exchange: nanos(self.options.phy.exchange(0, 0)),
            supervision_timeout: nanos(self.options.supervision_timeout),
            horizon: nanos(until),
        })
    }

    fn apply_idle(&mut self, idle: &IdleAir) {
        for link in &idle.links {
            if let Some(connection) = self.connections.get_mut(&link.id) {
                connection.anchor = Duration::from_nanos(link.anchor);
                for side in [CENTRAL, PERIPHERAL] {
                    let received = Duration::from_nanos(link.last_received[side]);
                    connection.on_received(side, received);
                    connection.sides[side].last_event = Duration::from_nanos(link.last_event[side]);
                }
            }
            self.schedule(Timer::Anchor(link.id));
        }
        let exchange = Duration::from_nanos(idle.exchange);
        for (adapter, radio) in self.adapters.values_mut().zip(&idle.radios) {
            adapter.stats.busy += radio.exchanges * exchange;
            adapter.stats.pdus += radio.packets;
            adapter.stats.bytes_on_air += radio.packets * u64::from(Phy::bits(0) / 8);
        }
    }
}

impl IdleAir {
    /// Simulates events in the order of time. Returns `false` if there was none before the horizon.
    fn run(&mut self, rng: &mut SimRng) -> bool {
        for index in 0..self.links.len() {
            self.check_supervision(index);
        }
        let mut has_run = false;
        // The first of the connections whose events start at the same time is the one with the lowest id.
        while let Some(index) = (0..self.links.len()).min_by_key(|index| self.links[*index].anchor)
        {
            if self.links[index].anchor + self.exchange > self.horizon {
                break;
            }
            self.event(index, rng);
            has_run = true;
        }
        has_run
    }

    fn event(&mut self, index: usize, rng: &mut SimRng) {
        let start = self.links[index].anchor;
        let end = start + self.exchange;
        self.links[index].anchor += self.links[index].period;
        let [central, peripheral] = self.links[index].radios;
        let mut is_received = [false; 2];
        if self.gets_radio(index, CENTRAL, start) {
            let is_listening = self.gets_radio(index, PERIPHERAL, start);
            let is_event_lost = rng.random_bool(self.event_loss);
            self.links[index].last_event[CENTRAL] = start;
            self.radios[central].on_exchange(end);
            self.radios[central].packets += 1;
            if is_listening {
                self.links[index].last_event[PERIPHERAL] = start;
                self.radios[peripheral].on_exchange(end);
            }
            if is_listening && !is_event_lost {
                self.radios[peripheral].packets += 1;
                is_received = [(); 2].map(|()| !rng.random_bool(self.packet_loss));
            }
        }
        for side in [CENTRAL, PERIPHERAL] {
            if is_received[side] {
                self.links[index].last_received[1 - side] = end;
            }
        }
        if is_received != [true; 2] {
            self.check_supervision(index);
        }
    }

    /// Ends the run before a supervision timeout that the link's next event comes too late to prevent.
    fn check_supervision(&mut self, index: usize) {
        let link = &self.links[index];
        let oldest = link.last_received[0].min(link.last_received[1]);
        let times_out_at = oldest + self.supervision_timeout;
        if times_out_at < link.anchor + self.exchange {
            self.horizon = self.horizon.min(times_out_at);
        }
    }

    fn gets_radio(&self, index: usize, side: usize, start: u64) -> bool {
        let radio = &self.radios[self.links[index].radios[side]];
        if radio.busy_until > start {
            return false;
        }
        radio.links.iter().all(|(other, other_side)| {
            *other == index || self.links[*other].anchor >= start + self.exchange || {
                let own = self.claim(index, side, start);
                let theirs = self.claim(*other, *other_side, self.links[*other].anchor);
                !own.yields_to(&theirs, self.arbitration)
            }
        })
    }

    fn claim(&self, index: usize, side: usize, next_event: u64) -> Claim {
        let link = &self.links[index];
        Claim {
            is_own_clock: side == CENTRAL,
            last_event: (Duration::from_nanos(link.last_event[side]), link.id.0),
            next_event: Duration::from_nanos(next_event),
            times_out_at: Duration::from_nanos(link.last_received[side] + self.supervision_timeout),
            interval: Duration::from_nanos(link.interval),
        }
    }
}

impl IdleRadio {
    fn on_exchange(&mut self, end: u64) {
        self.busy_until = end;
        self.exchanges += 1;
    }
}

fn nanos(span: Duration) -> u64 {
    u64::try_from(span.as_nanos()).unwrap_or(u64::MAX)
}
