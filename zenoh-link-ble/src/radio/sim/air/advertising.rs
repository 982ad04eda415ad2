//! Owns advertising events: who hears them, and the connections that initiators make of them.
use std::time::Duration;

use super::{due::Due, Air, ConnectionId};
use crate::radio::sim::{
    adapter::Dial,
    air::AdapterId,
    channel::Channel,
    connection::{Connection, CENTRAL, PERIPHERAL},
    message::{ChannelId, Event, Heard, RequestId},
    options::{ADVERTISING_DELAY, ADVERTISING_INTERVAL, SIGHTING_INTERVAL, TRANSMIT_WINDOW},
    packet::Signal,
};

impl Air {
    /// One advertising event: scanners report it, initiators connect.
    pub(super) fn on_advertise(&mut self, advertiser: AdapterId, request: RequestId) {
        let delay = ADVERTISING_INTERVAL + self.dice.up_to(ADVERTISING_DELAY);
        let Some(adapter) = self.adapters.get_mut(&advertiser) else {
            return;
        };
        let device = adapter.address;
        let Some(advertising) = adapter.advertisements.get_mut(&request) else {
            return;
        };
        advertising.next = self.now + delay;
        let heard = Heard {
            device,
            advertisement: advertising.advertisement,
            name: advertising.name.clone(),
            rssi_dbm: self.figures.rssi_dbm,
        };
        let listeners = self.adapters.iter().filter(|(_, a)| a.listens());
        let others: Vec<_> = listeners.map(|(id, _)| *id).collect();
        for other in others {
            if other != advertiser && self.is_in_range(other, advertiser) {
                self.on_advertisement_near(other, (advertiser, request), &heard);
            }
        }
    }

    fn on_advertisement_near(
        &mut self,
        listener: AdapterId,
        source: (AdapterId, RequestId),
        heard: &Heard,
    ) {
        let Some(adapter) = self.adapters.get(&listener) else {
            return;
        };
        let is_wanted = |dial: &Dial| dial.peer == heard.device;
        let is_initiator = adapter.dials.values().any(is_wanted);
        if !is_initiator && adapter.scan.is_none() {
            return;
        }
        if !self.dice.chance(self.figures.advertisement_heard) {
            return;
        }
        self.report(listener, source, heard);
        let (advertiser, _) = source;
        if is_initiator && self.connection_between(listener, advertiser).is_none() {
            self.establish(listener, advertiser);
        }
    }

    fn report(&mut self, scanner: AdapterId, source: (AdapterId, RequestId), heard: &Heard) {
        let now = self.now;
        let Some(adapter) = self.adapters.get_mut(&scanner) else {
            return;
        };
        let Some(reported) = &mut adapter.scan else {
            return;
        };
        let is_news = reported
            .get(&source)
            .is_none_or(|last| now >= *last + SIGHTING_INTERVAL);
        if !is_news {
            return;
        }
        reported.insert(source, now);
        let rssi_dbm = self
            .dice
            .around(self.figures.rssi_dbm, self.figures.rssi_jitter_db);
        let heard = Heard {
            rssi_dbm,
            ..heard.clone()
        };
        self.tell(scanner, Event::Sighting(heard));
    }

    fn establish(&mut self, central: AdapterId, peripheral: AdapterId) {
        let anchor = self.first_anchor(central, peripheral);
        self.last_connection += 1;
        let id = ConnectionId(self.last_connection);
        self.connections
            .insert(id, Connection::new(central, peripheral, anchor));
        for due in [
            Due::Anchor(id),
            Due::GiveUp(id, CENTRAL),
            Due::GiveUp(id, PERIPHERAL),
        ] {
            self.plan(due);
        }
        self.open_dialled(id, central, peripheral);
        // Whoever was dialling the other way round uses the same connection.
        self.open_dialled(id, peripheral, central);
    }

    fn open_dialled(&mut self, id: ConnectionId, from: AdapterId, to: AdapterId) {
        let Some(peer) = self.adapters.get(&to).map(|adapter| adapter.address) else {
            return;
        };
        let Some(adapter) = self.adapters.get_mut(&from) else {
            return;
        };
        let dials = std::mem::take(&mut adapter.dials);
        let (mine, others) = dials.into_iter().partition(|(_, dial)| dial.peer == peer);
        adapter.dials = others;
        for (request, dial) in mine {
            self.open(id, from, request, dial);
        }
    }

    /// Asks for a channel on a connection that is there.
    pub(super) fn open(
        &mut self,
        id: ConnectionId,
        from: AdapterId,
        request: RequestId,
        dial: Dial,
    ) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let Some(side) = connection.side_of(from) else {
            return;
        };
        self.last_channel += 1;
        let channel = ChannelId(self.last_channel);
        let opening = Channel::opening(
            side,
            request,
            dial.recv_mtu,
            self.options.mps,
            self.options.ahead_bytes(),
        );
        connection.channels.insert(channel, opening);
        connection.idle_since = None;
        let psm = dial.psm;
        connection.signal(side, Signal::ConnectRequest { channel, psm });
        self.homes.insert(channel, id);
    }

    /// The connection of two adapters, as long as either side holds it.
    pub(super) fn connection_between(&self, a: AdapterId, b: AdapterId) -> Option<ConnectionId> {
        self.connections
            .iter()
            .find(|(_, c)| c.side_of(a).is_some() && c.side_of(b).is_some())
            .map(|(id, _)| *id)
    }

    /// The first event of a new connection: in the middle of the largest gap between those the two radios have
    /// already, so that connections share an adapter's time fairly. (Intervals are all the same.)
    fn first_anchor(&self, a: AdapterId, b: AdapterId) -> Duration {
        let earliest = self.now + TRANSMIT_WINDOW;
        let interval = self.options.interval;
        let interval_ns = interval.as_nanos();
        // Everything is counted from `earliest`, so that the gaps are those a new event would fall in.
        let phase = |anchor: Duration| {
            let apart =
                anchor.as_nanos() + interval_ns * 1_000_000 - earliest.as_nanos() % interval_ns;
            apart % interval_ns
        };
        let mut phases: Vec<u128> = self
            .connections
            .values()
            .filter(|c| c.side_of(a).is_some() || c.side_of(b).is_some())
            .map(|c| phase(c.anchor))
            .collect();
        phases.sort_unstable();
        let Some(first) = phases.first().copied() else {
            return earliest;
        };
        let mut best = (0, 0);
        for (index, from) in phases.iter().enumerate() {
            let to = phases
                .get(index + 1)
                .copied()
                .unwrap_or(first + interval_ns);
            best = best.max((to - from, from + (to - from) / 2));
        }
        let offset_ns = best.1 % interval_ns;
        earliest + Duration::from_nanos(u64::try_from(offset_ns).unwrap_or(0))
    }
}
