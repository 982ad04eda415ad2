//! Simulates connection events: which packets are exchanged, and which of them are lost.
use super::{timers::Timer, Air, ConnectionId};
use crate::{
    adapter::AdapterStats,
    connection::{Exchange, CENTRAL, PERIPHERAL},
    id::AdapterId,
    phy::Phy,
};

/// Payload of an LL_TERMINATE_IND: a code and a reason.
const TERMINATE_BYTES: usize = 2;

impl Air {
    /// Starts a connection event if the central's radio is free for it. If the peripheral's radio is not, the central
    /// transmits without an answer.
    pub(super) fn on_anchor(&mut self, id: ConnectionId) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        connection.anchor += connection.period;
        if connection.exchange.is_some() {
            return;
        }
        if connection.is_terminating {
            if !self.is_busy(id) {
                self.terminate(id);
            }
            return;
        }
        if !connection.sides[CENTRAL].is_up || !self.gets_radio(id, CENTRAL) {
            return;
        }
        let is_peripheral_listening = self.gets_radio(id, PERIPHERAL);
        let is_event_lost = self.rng.random_bool(self.figures.event_loss);
        let now = self.now;
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.sides[CENTRAL].last_event = now;
            if is_peripheral_listening {
                connection.sides[PERIPHERAL].last_event = now;
            }
            connection.is_peripheral_listening = is_peripheral_listening;
            connection.is_event_lost = is_event_lost;
            connection.losses_in_row = 0;
        }
        self.start_exchange(id);
    }

    /// Ends the exchange in progress.
    pub(super) fn finish_exchange(&mut self, id: ConnectionId) {
        let now = self.now;
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let Some(exchange) = connection.exchange.take() else {
            return;
        };
        let mut is_peripheral_received = false;
        for side in [CENTRAL, PERIPHERAL] {
            let Some(connection) = self.connections.get_mut(&id) else {
                return;
            };
            // Packets in transmission are lost when the radio contact is cut.
            let is_received =
                exchange.is_received[side] && connection.sides[1 - side].is_up && !self.is_cut;
            is_peripheral_received = side == PERIPHERAL && is_received;
            if is_received {
                connection.losses_in_row = 0;
                connection.on_received(1 - side, now);
                self.deliver(id, side);
            } else if connection.losses_in_row < 2 {
                connection.losses_in_row += 1;
            }
        }
        if is_peripheral_received {
            // The header of the peripheral's packet acknowledges the central's packet.
            self.acknowledge(id, CENTRAL);
        }
        if self.should_continue(id) {
            self.start_exchange(id);
        } else if is_peripheral_received {
            self.on_good_event(id);
        }
    }

    fn on_good_event(&mut self, id: ConnectionId) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        if let Some(interval) = connection.on_good_event() {
            let central = connection.sides[CENTRAL].adapter;
            let clock = self.adapters.get(&central).map(|adapter| adapter.clock);
            connection.period = clock.unwrap_or_default().true_time(interval);
        }
    }

    fn start_exchange(&mut self, id: ConnectionId) {
        let payload_bytes = self.options.pdu.bytes();
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let [central, peripheral] = [0, 1].map(|side| connection.sides[side].adapter);
        let (central_bytes, is_repeat) = connection.start_transmission(CENTRAL, payload_bytes);
        let is_listening = connection.is_peripheral_listening;
        let is_audible =
            connection.sides[PERIPHERAL].is_up && is_listening && !connection.is_event_lost;
        self.count(central, central_bytes, is_repeat);
        let mut exchange = Exchange {
            ends_at: self.now + self.options.phy.exchange(central_bytes, 0),
            is_received: [false, false],
        };
        // A peripheral that receives nothing does not respond. One that receives a damaged packet responds and requests
        // it again.
        if is_audible && self.is_in_range(central, peripheral) {
            exchange.is_received[CENTRAL] = !self.is_lost(central_bytes);
            if exchange.is_received[CENTRAL] {
                self.acknowledge(id, PERIPHERAL);
            }
            let (peripheral_bytes, is_repeat) = match self.connections.get_mut(&id) {
                Some(connection) => connection.start_transmission(PERIPHERAL, payload_bytes),
                None => (0, false),
            };
            self.count(peripheral, peripheral_bytes, is_repeat);
            exchange.is_received[PERIPHERAL] = !self.is_lost(peripheral_bytes);
            exchange.ends_at =
                self.now + self.options.phy.exchange(central_bytes, peripheral_bytes);
        }
        let duration = exchange.ends_at - self.now;
        for (adapter, is_used) in [(central, true), (peripheral, is_listening)] {
            if let Some(stats) = self.stats_mut(adapter).filter(|_| is_used) {
                stats.busy += duration;
            }
        }
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.exchange = Some(exchange);
        }
        self.schedule(Timer::ExchangeEnd(id));
    }

    /// Returns whether the event continues with another exchange: there is data to send and time for it.
    fn should_continue(&self, id: ConnectionId) -> bool {
        let Some(connection) = self.connections.get(&id) else {
            return false;
        };
        let has_data = connection.has_data(CENTRAL) || connection.has_data(PERIPHERAL);
        let is_up = connection.sides.iter().all(|side| side.is_up);
        has_data
            && is_up
            && connection.losses_in_row < 2
            && self.now + self.next_exchange(id) <= self.event_limit(id)
    }

    /// Sends the termination of the side that left. This is repeated at every event until the other side receives it.
    fn terminate(&mut self, id: ConnectionId) {
        let Some(connection) = self.connections.get(&id) else {
            return;
        };
        // The side that left may be off or detached; its controller still sends the termination.
        let names = connection.sides.each_ref().map(|side| {
            let adapter = self.adapters.get(&side.adapter);
            adapter.map_or("", |adapter| adapter.name.as_str())
        });
        let is_cut = self.is_cut || self.is_cut_between(names[CENTRAL], names[PERIPHERAL]);
        let is_lost = self.rng.random_bool(self.figures.event_loss)
            || self.is_lost(TERMINATE_BYTES)
            || is_cut;
        let Some(connection) = self.connections.get(&id) else {
            return;
        };
        let staying = connection.sides.iter().position(|side| side.is_up);
        if let Some(side) = staying.filter(|_| !is_lost) {
            self.drop_side(id, side);
        }
    }

    pub(super) fn is_lost(&mut self, payload_bytes: usize) -> bool {
        self.rng
            .random_bool(self.figures.packet_loss(payload_bytes))
    }

    fn count(&mut self, adapter: AdapterId, payload_bytes: usize, is_repeat: bool) {
        if let Some(stats) = self.stats_mut(adapter) {
            stats.bytes_on_air += u64::from(Phy::bits(payload_bytes) / 8);
            stats.pdus += 1;
            stats.repeats += u64::from(is_repeat);
        }
    }

    pub(super) fn stats_mut(&mut self, adapter: AdapterId) -> Option<&mut AdapterStats> {
        self.adapters.get_mut(&adapter).map(|a| &mut a.stats)
    }
}
