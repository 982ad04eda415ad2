//! Simulates advertising events: which adapters receive them, and the connections that initiators establish in
//! response.
use std::time::Duration;
use zenoh_link_ble_radio::address::DeviceAddress;

use super::{
    advertising_channel::{event_airtime, ScanPattern, CONNECT_BYTES},
    timers::Timer,
    Air, ConnectionId,
};
use crate::{
    adapter::{Adapter, Dial},
    channel::Channel,
    connection::{Connection, CENTRAL, PERIPHERAL},
    id::AdapterId,
    message::{ChannelId, Event, ReceivedAdvertisement, RequestId},
    options::{ADVERTISING_DELAY, REPORT_INTERVAL, TRANSMIT_WINDOW},
    packet::Signal,
};

impl Air {
    /// Starts an advertising event, unless a connection uses the radio.
    pub(super) fn on_advertise(&mut self, advertiser: AdapterId, request: RequestId) {
        let interval = self.options.advertising_interval;
        let delay = interval + self.rng.random_duration(ADVERTISING_DELAY);
        let now = self.now;
        let is_busy = self.is_radio_in_use(advertiser);
        let Some(adapter) = self.adapters.get_mut(&advertiser) else {
            return;
        };
        let delay = adapter.clock.true_time(delay);
        let Some(advertising) = adapter.advertisements.get_mut(&request) else {
            return;
        };
        advertising.next = now + delay;
        if is_busy {
            return;
        }
        adapter.stats.advertising += event_airtime();
        self.advertising_channel.on_event(now, advertiser);
        let is_received = self.adapters.values().any(Adapter::receives_advertisements);
        if let Some(adapter) = self.adapters.get_mut(&advertiser).filter(|_| is_received) {
            if let Some(advertising) = adapter.advertisements.get_mut(&request) {
                advertising.event = Some(now);
                self.schedule(Timer::AdvertisingEnd(advertiser, request));
            }
        }
    }

    /// Ends an advertising event: scanners report it, initiators connect.
    pub(super) fn on_advertising_end(&mut self, advertiser: AdapterId, request: RequestId) {
        let Some(adapter) = self.adapters.get_mut(&advertiser) else {
            return;
        };
        let device = adapter.address;
        let Some(advertising) = adapter.advertisements.get_mut(&request) else {
            return;
        };
        let Some(start) = advertising.event.take() else {
            return;
        };
        let received = ReceivedAdvertisement {
            device,
            advertisement: advertising.advertisement,
            name: advertising.name.clone(),
            rssi_dbm: self.figures.rssi_dbm,
        };
        let receivers = self
            .adapters
            .iter()
            .filter(|(id, a)| **id != advertiser && a.receives_advertisements());
        let receivers: Vec<_> = receivers.map(|(id, _)| *id).collect();
        let mut receptions = Vec::new();
        for receiver in receivers {
            if self.is_in_range(receiver, advertiser) {
                let channel = self.receiving_channel(receiver, advertiser, start, device);
                receptions.extend(channel.map(|channel| (channel, receiver)));
            }
        }
        receptions.sort_unstable();
        for on_channel in receptions.chunk_by(|(a, _), (b, _)| a == b) {
            for (_, receiver) in on_channel {
                self.report(*receiver, (advertiser, request), &received);
            }
            let initiators: Vec<_> = on_channel
                .iter()
                .map(|(_, receiver)| *receiver)
                .filter(|receiver| self.initiates(*receiver, advertiser, device))
                .collect();
            // The requests of several initiators collide with each other.
            let is_alone = initiators.len() == 1;
            let mut is_connected = false;
            for initiator in initiators {
                is_connected = is_alone && self.receives_request(initiator, advertiser, start);
                self.establish(initiator, advertiser, is_connected);
            }
            // The event ends with the request.
            if is_connected {
                return;
            }
        }
    }

    /// Returns whether an adapter waits for the advertiser in order to connect.
    fn initiates(&self, receiver: AdapterId, advertiser: AdapterId, device: DeviceAddress) -> bool {
        let is_initiator = self
            .adapters
            .get(&receiver)
            .is_some_and(|adapter| adapter.dials_to(device));
        is_initiator && self.connection_between(receiver, advertiser).is_none()
    }

    /// Returns the channel on which an adapter receives a packet of the advertising event that started at `start`, if it
    /// receives one.
    fn receiving_channel(
        &mut self,
        receiver: AdapterId,
        advertiser: AdapterId,
        start: Duration,
        device: DeviceAddress,
    ) -> Option<u32> {
        let adapter = self.adapters.get(&receiver)?;
        if !adapter.dials_to(device) && adapter.scan.is_none() {
            return None;
        }
        let pattern = ScanPattern {
            since: adapter.receiving_since,
            interval: self.options.scan_interval,
            window: self.options.scan_window,
        };
        let channel = pattern.channel(start)?;
        if self.is_radio_in_use(receiver)
            || self.advertising_channel.is_advertising(receiver, start)
        {
            return None;
        }
        let has_collided = self
            .advertising_channel
            .overlapping(start, advertiser)
            .any(|other| self.is_in_range(receiver, other));
        self.collisions.on_packet(has_collided);
        let is_received =
            !has_collided && self.rng.random_bool(self.figures.advertisement_reception);
        is_received.then_some(channel)
    }

    /// Returns whether the advertiser receives the connect request of an initiator.
    fn receives_request(
        &mut self,
        initiator: AdapterId,
        advertiser: AdapterId,
        start: Duration,
    ) -> bool {
        let has_collided = self
            .advertising_channel
            .overlapping_request(start, advertiser)
            .any(|other| other != initiator && self.is_in_range(advertiser, other));
        !has_collided && !self.is_lost(CONNECT_BYTES)
    }

    /// Returns whether a connection event uses the adapter's radio now.
    fn is_radio_in_use(&self, adapter: AdapterId) -> bool {
        self.connections.values().any(|connection| {
            let side = connection.side_of(adapter);
            side.is_some_and(|side| connection.is_using_radio(side))
        })
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

    /// Begins a connection. If the peripheral has not received the request, the central finds out when no event of the
    /// connection succeeds.
    fn establish(&mut self, central: AdapterId, peripheral: AdapterId, is_received: bool) {
        let anchor = self.first_anchor(central, peripheral);
        self.last_connection += 1;
        let id = ConnectionId(self.last_connection);
        let (interval, period) = self.interval_for(central, peripheral);
        let mut connection = Connection::new(central, peripheral, anchor, interval);
        connection.period = period;
        if !is_received {
            connection.sides[PERIPHERAL].shut_down();
        }
        self.connections.insert(id, connection);
        for timer in [
            Timer::Anchor(id),
            Timer::SupervisionTimeout(id, CENTRAL),
            Timer::SupervisionTimeout(id, PERIPHERAL),
        ] {
            self.schedule(timer);
        }
        self.open_dialled(id, central, peripheral);
        if is_received {
            // Dials in the opposite direction use the same connection.
            self.open_dialled(id, peripheral, central);
        }
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
