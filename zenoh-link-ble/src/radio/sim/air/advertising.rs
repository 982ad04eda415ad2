//! Simulates advertising events: which adapters receive them, and the connections that initiators establish in
//! response.
use std::time::Duration;

use super::{timers::Timer, Air, ConnectionId};
use crate::radio::sim::{
    adapter::Dial,
    channel::Channel,
    connection::{Connection, CENTRAL, PERIPHERAL},
    id::AdapterId,
    message::{ChannelId, Event, ReceivedAdvertisement, RequestId},
    options::{ADVERTISING_DELAY, ADVERTISING_INTERVAL, REPORT_INTERVAL, TRANSMIT_WINDOW},
    packet::Signal,
};

impl Air {
    /// Handles one advertising event: scanners report it, initiators connect.
    pub(super) fn on_advertise(&mut self, advertiser: AdapterId, request: RequestId) {
        let delay = ADVERTISING_INTERVAL + self.rng.random_duration(ADVERTISING_DELAY);
        let Some(adapter) = self.adapters.get_mut(&advertiser) else {
            return;
        };
        let device = adapter.address;
        let Some(advertising) = adapter.advertisements.get_mut(&request) else {
            return;
        };
        advertising.next = self.now + delay;
        let received = ReceivedAdvertisement {
            device,
            advertisement: advertising.advertisement,
            name: advertising.name.clone(),
            rssi_dbm: self.figures.rssi_dbm,
        };
        let receivers = self
            .adapters
            .iter()
            .filter(|(_, a)| a.receives_advertisements());
        let receivers: Vec<_> = receivers.map(|(id, _)| *id).collect();
        for receiver in receivers {
            if receiver != advertiser && self.is_in_range(receiver, advertiser) {
                self.on_advertisement_in_range(receiver, (advertiser, request), &received);
            }
        }
    }

    fn on_advertisement_in_range(
        &mut self,
        receiver: AdapterId,
        source: (AdapterId, RequestId),
        received: &ReceivedAdvertisement,
    ) {
        let Some(adapter) = self.adapters.get(&receiver) else {
            return;
        };
        let matches = |dial: &Dial| dial.peer == received.device;
        let is_initiator = adapter.dials.values().any(matches);
        if !is_initiator && adapter.scan.is_none() {
            return;
        }
        if !self.rng.random_bool(self.figures.advertisement_reception) {
            return;
        }
        self.report(receiver, source, received);
        let (advertiser, _) = source;
        if is_initiator && self.connection_between(receiver, advertiser).is_none() {
            self.establish(receiver, advertiser);
        }
    }

    fn report(
        &mut self,
        scanner: AdapterId,
        source: (AdapterId, RequestId),
        received: &ReceivedAdvertisement,
    ) {
        let now = self.now;
        let Some(adapter) = self.adapters.get_mut(&scanner) else {
            return;
        };
        let Some(reported) = &mut adapter.scan else {
            return;
        };
        let is_due = reported
            .get(&source)
            .is_none_or(|last| now >= *last + REPORT_INTERVAL);
        if !is_due {
            return;
        }
        reported.insert(source, now);
        let rssi_dbm = self
            .rng
            .random_around(self.figures.rssi_dbm, self.figures.rssi_jitter_db);
        let received = ReceivedAdvertisement {
            rssi_dbm,
            ..received.clone()
        };
        self.emit(scanner, Event::AdvertisementReceived(received));
    }

    fn establish(&mut self, central: AdapterId, peripheral: AdapterId) {
        let anchor = self.first_anchor(central, peripheral);
        self.last_connection += 1;
        let id = ConnectionId(self.last_connection);
        let (interval, period) = self.interval_for(central, peripheral);
        let mut connection = Connection::new(central, peripheral, anchor, interval);
        connection.period = period;
        self.connections.insert(id, connection);
        for timer in [
            Timer::Anchor(id),
            Timer::SupervisionTimeout(id, CENTRAL),
            Timer::SupervisionTimeout(id, PERIPHERAL),
        ] {
            self.schedule(timer);
        }
        self.open_dialled(id, central, peripheral);
        // Dials in the opposite direction use the same connection.
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

    /// Requests a channel on an existing connection.
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
        self.channel_connections.insert(channel, id);
    }

    /// Returns the connection of two adapters, while at least one side keeps it.
    pub(super) fn connection_between(&self, a: AdapterId, b: AdapterId) -> Option<ConnectionId> {
        self.connections
            .iter()
            .find(|(_, c)| c.side_of(a).is_some() && c.side_of(b).is_some())
            .map(|(id, _)| *id)
    }

    /// Returns the time of the first event of a new connection: in the middle of the largest gap between the events of
    /// the two radios' other connections, so that connections share the time of an adapter fairly. A controller does not
    /// know the peripheral's other connections; with equal intervals, drift soon moves the events anyway.
    fn first_anchor(&self, a: AdapterId, b: AdapterId) -> Duration {
        let earliest = self.now + TRANSMIT_WINDOW;
        let interval = self.options.interval;
        let interval_ns = interval.as_nanos();
        // All phases are relative to `earliest`, so that they describe the gaps in which a new event would lie.
        let phase = |anchor: Duration| {
            let offset =
                anchor.as_nanos() + interval_ns * 1_000_000 - earliest.as_nanos() % interval_ns;
            offset % interval_ns
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
        // The size of the largest gap, and its middle.
        let mut largest_gap = (0, 0);
        for (index, from) in phases.iter().enumerate() {
            let to = phases
                .get(index + 1)
                .copied()
                .unwrap_or(first + interval_ns);
            largest_gap = largest_gap.max((to - from, from + (to - from) / 2));
        }
        let offset_ns = largest_gap.1 % interval_ns;
        earliest + Duration::from_nanos(u64::try_from(offset_ns).unwrap_or(0))
    }
}
