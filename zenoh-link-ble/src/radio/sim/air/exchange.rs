//! Simulates connection events: which connection uses the radios, which packets are exchanged, and which of them are
//! lost.
use std::time::Duration;

use super::{timers::Timer, Air, ConnectionId};
use crate::radio::sim::{
    adapter::AdapterStats,
    air::AdapterId,
    connection::{Exchange, CENTRAL, PERIPHERAL},
    phy::Phy,
};

/// Payload of an LL_TERMINATE_IND: a code and a reason.
const TERMINATE_BYTES: usize = 2;

impl Air {
    /// Starts a connection event if both radios are free.
    pub(super) fn on_anchor(&mut self, id: ConnectionId) {
        let is_busy = self.is_busy(id);
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        connection.anchor += self.options.interval;
        if is_busy || connection.exchange.is_some() {
            return;
        }
        if connection.is_terminating {
            self.terminate(id);
            return;
        }
        if !connection.sides[CENTRAL].is_up {
            return;
        }
        if !self.may_start_event(id) {
            return;
        }
        let is_event_lost = self.rng.random_bool(self.figures.event_loss);
        if let Some(connection) = self.connections.get_mut(&id) {
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
            if let Some(connection) = self.connections.get_mut(&id) {
                connection.on_good_event();
            }
        }
    }

    fn start_exchange(&mut self, id: ConnectionId) {
        let payload_bytes = self.options.pdu.bytes();
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let [central, peripheral] = [0, 1].map(|side| connection.sides[side].adapter);
        let (central_bytes, is_repeat) = connection.start_transmission(CENTRAL, payload_bytes);
        let is_audible = connection.sides[PERIPHERAL].is_up && !connection.is_event_lost;
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
        for adapter in [central, peripheral] {
            if let Some(stats) = self.stats_mut(adapter) {
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
        let limit = self
            .competing_connections(id)
            .map(|(_, at)| at)
            .fold(connection.anchor, Duration::min);
        has_data
            && is_up
            && connection.losses_in_row < 2
            && self.now + self.next_exchange(id) <= limit
    }

    /// Returns whether the connection may start an event now. If the event would overlap with an event of another
    /// connection, the connection that has waited longer goes first.
    fn may_start_event(&mut self, id: ConnectionId) -> bool {
        let ends_at = self.now + self.next_exchange(id);
        let Some(connection) = self.connections.get(&id) else {
            return false;
        };
        let own = (connection.last_event, id);
        let must_wait = self
            .competing_connections(id)
            .filter(|(_, at)| *at < ends_at)
            .filter_map(|(competitor, _)| {
                Some((self.connections.get(&competitor)?.last_event, competitor))
            })
            .any(|theirs| theirs < own);
        if must_wait {
            return false;
        }
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.last_event = self.now;
        }
        true
    }

    /// Returns the maximum duration of the connection's next exchange.
    fn next_exchange(&self, id: ConnectionId) -> Duration {
        let payload_bytes = self.options.pdu.bytes();
        let [central, peripheral] = match self.connections.get(&id) {
            Some(c) => [CENTRAL, PERIPHERAL].map(|side| c.next_bytes(side, payload_bytes)),
            None => [0, 0],
        };
        self.options.phy.exchange(central, peripheral)
    }

    /// Returns the other connections that use one of this connection's radios, and the times of their next events.
    fn competing_connections(
        &self,
        id: ConnectionId,
    ) -> impl Iterator<Item = (ConnectionId, Duration)> + '_ {
        let this = self.connections.get(&id);
        self.connections
            .iter()
            .filter(move |(other, connection)| {
                **other != id && this.is_some_and(|this| this.shares_radio(connection))
            })
            .map(|(other, connection)| (*other, connection.anchor))
    }

    fn is_busy(&self, id: ConnectionId) -> bool {
        self.competing_connections(id).any(|(competitor, _)| {
            let competitor = self.connections.get(&competitor);
            competitor.is_some_and(|connection| connection.exchange.is_some())
        })
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

    fn is_lost(&mut self, payload_bytes: usize) -> bool {
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
