//! Decides which connection gets a radio, and until when: [`arbitration`](crate::arbitration) applied to the
//! connections of the air.
use std::time::Duration;

use super::{AdapterId, Air, ConnectionId};
use crate::{
    arbitration::Claim,
    connection::{Connection, CENTRAL, PERIPHERAL},
};

impl Air {
    /// Returns whether the connection gets the radio of `side` for an event that starts now.
    pub(super) fn gets_radio(&self, id: ConnectionId, side: usize) -> bool {
        let Some(connection) = self.connections.get(&id) else {
            return false;
        };
        let ends_at = self.now + self.next_exchange(id);
        let own = self.claim(id, connection, side, self.now);
        self.others_on(connection.sides[side].adapter, id)
            .all(|(other_id, other, other_side)| {
                if other.is_using_radio(other_side) {
                    return false;
                }
                other.anchor >= ends_at || !other.sides[other_side].is_up || {
                    let theirs = self.claim(other_id, other, other_side, other.anchor);
                    !own.yields_to(&theirs, self.options.arbitration)
                }
            })
    }

    /// Returns whether another connection uses one of the connection's radios now.
    pub(super) fn is_busy(&self, id: ConnectionId) -> bool {
        self.others(id)
            .any(|(_, other, side)| other.is_using_radio(side))
    }

    /// Returns the time at which the connection's event must end: its own next event, or that of another connection of
    /// the two radios.
    pub(super) fn event_limit(&self, id: ConnectionId) -> Duration {
        let own = self.connections.get(&id).map_or(self.now, |own| own.anchor);
        self.others(id)
            .filter(|(_, other, side)| other.sides[*side].is_up)
            .map(|(_, other, _)| other.anchor)
            .fold(own, Duration::min)
    }

    /// Returns the maximum duration of the connection's next exchange.
    pub(super) fn next_exchange(&self, id: ConnectionId) -> Duration {
        let payload_bytes = self.options.pdu.bytes();
        let [central, peripheral] = match self.connections.get(&id) {
            Some(c) => [CENTRAL, PERIPHERAL].map(|side| c.next_bytes(side, payload_bytes)),
            None => [0, 0],
        };
        self.options.phy.exchange(central, peripheral)
    }

    fn claim(
        &self,
        id: ConnectionId,
        connection: &Connection,
        side: usize,
        next_event: Duration,
    ) -> Claim {
        Claim {
            is_own_clock: side == CENTRAL,
            last_event: (connection.sides[side].last_event, id.0),
            next_event,
            times_out_at: connection.supervision_ends_at(side, &self.options),
            interval: connection.interval,
        }
    }

    /// Returns the other connections that use one of this connection's radios, and their side of that radio.
    fn others(
        &self,
        id: ConnectionId,
    ) -> impl Iterator<Item = (ConnectionId, &Connection, usize)> + '_ {
        let radios = self
            .connections
            .get(&id)
            .map(|connection| connection.sides.each_ref().map(|side| side.adapter));
        let radios = radios.into_iter().flatten();
        radios.flat_map(move |radio| self.others_on(radio, id))
    }

    /// Returns the connections of the adapter except `id`, and its side of each.
    fn others_on(
        &self,
        adapter: AdapterId,
        id: ConnectionId,
    ) -> impl Iterator<Item = (ConnectionId, &Connection, usize)> + '_ {
        self.connections
            .iter()
            .filter(move |(other, _)| **other != id)
            .filter_map(move |(other, connection)| {
                let side = connection.side_of(adapter)?;
                Some((*other, connection, side))
            })
    }
}
