//! Owns connection events: which connection has the radios, which packets meet, and which of them are lost.
use std::time::Duration;

use super::{due::Due, Air, ConnectionId};
use crate::radio::sim::{
    adapter::AdapterStats,
    air::AdapterId,
    connection::{Exchange, CENTRAL, PERIPHERAL},
    phy::Phy,
};

/// An LL_TERMINATE_IND has a code and a reason.
const TERMINATE_BYTES: usize = 2;

impl Air {
    /// An event of the connection begins, if both radios are free for it.
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
        if !self.has_turn(id) {
            return;
        }
        let is_hit = self.dice.chance(self.figures.event_hit);
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.event_hit = is_hit;
            connection.losses_in_row = 0;
        }
        self.start_exchange(id);
    }

    /// The two packets on the air are over.
    pub(super) fn finish_exchange(&mut self, id: ConnectionId) {
        let now = self.now;
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let Some(exchange) = connection.exchange.take() else {
            return;
        };
        let mut is_peripheral_heard = false;
        for side in [CENTRAL, PERIPHERAL] {
            let Some(connection) = self.connections.get_mut(&id) else {
                return;
            };
            // What is on the air when everything is cut is lost.
            let is_heard =
                exchange.is_heard[side] && connection.sides[1 - side].is_up && !self.is_cut;
            is_peripheral_heard = side == PERIPHERAL && is_heard;
            if is_heard {
                connection.losses_in_row = 0;
                connection.on_heard(1 - side, now);
                self.deliver(id, side);
            } else if connection.losses_in_row < 2 {
                connection.losses_in_row += 1;
            }
        }
        if is_peripheral_heard {
            // Its header acknowledges what the central sent.
            self.acknowledge(id, CENTRAL);
        }
        if self.goes_on(id) {
            self.start_exchange(id);
        } else if is_peripheral_heard {
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
        let (central_bytes, is_repeat) = connection.take_off(CENTRAL, payload_bytes);
        let is_audible = connection.sides[PERIPHERAL].is_up && !connection.event_hit;
        self.count(central, central_bytes, is_repeat);
        let mut exchange = Exchange {
            ends_at: self.now + self.options.phy.exchange(central_bytes, 0),
            is_heard: [false, false],
        };
        // Who hears nothing at all does not answer; who hears a damaged packet does, and asks for it again.
        if is_audible && self.is_in_range(central, peripheral) {
            exchange.is_heard[CENTRAL] = !self.is_lost(central_bytes);
            if exchange.is_heard[CENTRAL] {
                self.acknowledge(id, PERIPHERAL);
            }
            let (peripheral_bytes, is_repeat) = match self.connections.get_mut(&id) {
                Some(connection) => connection.take_off(PERIPHERAL, payload_bytes),
                None => (0, false),
            };
            self.count(peripheral, peripheral_bytes, is_repeat);
            exchange.is_heard[PERIPHERAL] = !self.is_lost(peripheral_bytes);
            exchange.ends_at =
                self.now + self.options.phy.exchange(central_bytes, peripheral_bytes);
        }
        let taken = exchange.ends_at - self.now;
        for adapter in [central, peripheral] {
            if let Some(stats) = self.stats_mut(adapter) {
                stats.busy += taken;
            }
        }
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.exchange = Some(exchange);
        }
        self.plan(Due::ExchangeEnd(id));
    }

    /// Whether the event has room and reason for another exchange.
    fn goes_on(&self, id: ConnectionId) -> bool {
        let Some(connection) = self.connections.get(&id) else {
            return false;
        };
        let has_data = connection.has_data(CENTRAL) || connection.has_data(PERIPHERAL);
        let is_up = connection.sides.iter().all(|side| side.is_up);
        let limit = self
            .rivals(id)
            .map(|(_, at)| at)
            .fold(connection.anchor, Duration::min);
        has_data
            && is_up
            && connection.losses_in_row < 2
            && self.now + self.next_exchange(id) <= limit
    }

    /// Whether the connection may begin an event now. An event that would run into another connection's takes turns
    /// with it: the one that has waited longer goes first.
    fn has_turn(&mut self, id: ConnectionId) -> bool {
        let ends_at = self.now + self.next_exchange(id);
        let Some(connection) = self.connections.get(&id) else {
            return false;
        };
        let mine = (connection.last_turn, id);
        let is_second = self
            .rivals(id)
            .filter(|(_, at)| *at < ends_at)
            .filter_map(|(rival, _)| Some((self.connections.get(&rival)?.last_turn, rival)))
            .any(|theirs| theirs < mine);
        if is_second {
            return false;
        }
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.last_turn = self.now;
        }
        true
    }

    /// How long the connection's next exchange takes, at most.
    fn next_exchange(&self, id: ConnectionId) -> Duration {
        let payload_bytes = self.options.pdu.bytes();
        let [central, peripheral] = match self.connections.get(&id) {
            Some(c) => [CENTRAL, PERIPHERAL].map(|side| c.next_bytes(side, payload_bytes)),
            None => [0, 0],
        };
        self.options.phy.exchange(central, peripheral)
    }

    /// The other connections that need one of this one's radios, and when.
    fn rivals(&self, id: ConnectionId) -> impl Iterator<Item = (ConnectionId, Duration)> + '_ {
        let this = self.connections.get(&id);
        self.connections
            .iter()
            .filter(move |(other, connection)| {
                **other != id && this.is_some_and(|this| this.shares_radio(connection))
            })
            .map(|(other, connection)| (*other, connection.anchor))
    }

    fn is_busy(&self, id: ConnectionId) -> bool {
        self.rivals(id).any(|(rival, _)| {
            let rival = self.connections.get(&rival);
            rival.is_some_and(|connection| connection.exchange.is_some())
        })
    }

    /// One side left in good order and says so, until the other hears it.
    fn terminate(&mut self, id: ConnectionId) {
        let Some(connection) = self.connections.get(&id) else {
            return;
        };
        // The one that left may be off, or gone for good: its controller's last word is still on its way.
        let names = connection.sides.each_ref().map(|side| {
            let adapter = self.adapters.get(&side.adapter);
            adapter.map_or("", |adapter| adapter.name.as_str())
        });
        let is_cut = self.is_cut || self.is_cut_between(names[CENTRAL], names[PERIPHERAL]);
        let is_lost =
            self.dice.chance(self.figures.event_hit) || self.is_lost(TERMINATE_BYTES) || is_cut;
        let Some(connection) = self.connections.get(&id) else {
            return;
        };
        let staying = connection.sides.iter().position(|side| side.is_up);
        if let Some(side) = staying.filter(|_| !is_lost) {
            self.drop_side(id, side);
        }
    }

    fn is_lost(&mut self, payload_bytes: usize) -> bool {
        self.dice.chance(self.figures.packet_loss(payload_bytes))
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
