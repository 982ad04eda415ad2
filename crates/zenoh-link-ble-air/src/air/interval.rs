//! Sets connection intervals: for the next connection to a peer, and of an existing one by the link layer's connection
//! update procedure (Core Specification, Vol 6, Part B, 5.1.1), which only the central can start.
use std::time::Duration;
use zenoh_link_ble_radio::{address::DeviceAddress, interval::ConnectionInterval};

use super::{AdapterId, Air};

use crate::{connection::CENTRAL, message::Violation};

/// Largest number of peers for which an adapter keeps an interval. A controller has fewer connections.
const MAX_INTERVALS: usize = 128;

impl Air {
    /// Returns the interval of connections for which no other one is set.
    pub fn default_interval(&self) -> ConnectionInterval {
        ConnectionInterval::nearest(self.options.interval)
    }

    /// Returns whether an adapter can change the interval of an open connection.
    pub fn changes_open_connections(&self) -> bool {
        self.options.changes_open_connections
    }

    pub(super) fn set_interval(
        &mut self,
        id: AdapterId,
        peer: DeviceAddress,
        units: u16,
    ) -> Result<(), Violation> {
        let interval = ConnectionInterval::from_units(units).ok_or(Violation::Interval)?;
        let interval = interval.duration();
        if 2 * interval >= self.options.supervision_timeout {
            return Err(Violation::Interval);
        }
        let Some(adapter) = self.adapters.get_mut(&id) else {
            return Ok(());
        };
        if adapter.intervals.len() >= MAX_INTERVALS {
            adapter.intervals.clear();
        }
        adapter.intervals.insert(peer, interval);
        if !self.options.changes_open_connections {
            return Ok(());
        }
        let connection = self.connection_to(id, peer);
        let connection = connection.and_then(|connection| self.connections.get_mut(&connection));
        if let Some(connection) = connection.filter(|c| c.sides[CENTRAL].adapter == id) {
            connection.update_interval(interval);
        }
        Ok(())
    }

    /// Returns the interval that the central requests for a new connection, and the true time that passes meanwhile.
    pub(super) fn interval_for(
        &self,
        central: AdapterId,
        peripheral: AdapterId,
    ) -> (Duration, Duration) {
        let default = self.options.interval;
        let Some(adapter) = self.adapters.get(&central) else {
            return (default, default);
        };
        let peer = self.adapters.get(&peripheral).map(|peer| peer.address);
        let chosen = peer.and_then(|peer| adapter.intervals.get(&peer));
        let interval = chosen.copied().unwrap_or(default);
        (interval, adapter.clock.true_time(interval))
    }
}
