//! Models one LE connection between two adapters: the data that each side has to send, cut into link-layer packets, and
//! the next packet of each side. The air decides when packets are exchanged and which of them are lost.
use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use super::{
    channel::Channel,
    id::AdapterId,
    message::ChannelId,
    options::{AirOptions, ESTABLISH_INTERVALS, SETUP_EVENTS},
    packet::{Frame, Packet, Signal},
};

/// The central's side of a connection. The central sends first in every event.
pub(super) const CENTRAL: usize = 0;
/// The peripheral's side of a connection.
pub(super) const PERIPHERAL: usize = 1;

/// Number of events from the announcement of an interval until both sides change to it (Vol 6, Part B, 5.1.1).
const UPDATE_EVENTS: u8 = 6;

/// An LE connection.
#[derive(Debug)]
pub(super) struct Connection {
    pub(super) sides: [Side; 2],
    pub(super) channels: BTreeMap<ChannelId, Channel>,
    /// Time of the first connection event.
    created_at: Duration,
    /// Time of the next connection event.
    pub(super) anchor: Duration,
    /// Connection interval as the two sides have agreed on it.
    pub(super) interval: Duration,
    /// True time between two connection events: the interval by the central's clock.
    pub(super) period: Duration,
    /// Interval that the central has announced, and the number of successful events until both sides change to it.
    next_interval: Option<(Duration, u8)>,
    /// Exchange in progress.
    pub(super) exchange: Option<Exchange>,
    /// Whether the peripheral's radio takes part in the current event.
    pub(super) is_peripheral_listening: bool,
    /// Whether interference covers the current event.
    pub(super) is_event_lost: bool,
    /// Number of consecutive packets lost in the current event. The second one ends the event.
    pub(super) losses_in_row: u8,
    /// Number of remaining events that the controllers use for their own set-up procedures.
    setup_events_left: u8,
    /// Whether one side terminated the connection; the other side learns of it at the next successful event.
    pub(super) is_terminating: bool,
}

/// One side of a connection.
#[derive(Debug)]
pub(super) struct Side {
    pub(super) adapter: AdapterId,
    /// Whether this side still keeps the connection.
    pub(super) is_up: bool,
    /// Time at which the last event started for which the connection had this side's radio.
    pub(super) last_event: Duration,
    pub(super) last_received: Option<Duration>,
    signals: VecDeque<Signal>,
    frame: Option<Frame>,
    /// The packet sent last, until its acknowledgement is received.
    pub(super) in_flight: Option<Packet>,
    /// The channel that sent last. Channels take turns.
    last_served: ChannelId,
}

/// A packet of the central and the response of the peripheral.
#[derive(Debug)]
pub(super) struct Exchange {
    pub(super) ends_at: Duration,
    /// Whether the packet of each side is received by the other.
    pub(super) is_received: [bool; 2],
}

impl Connection {
    /// Returns a connection whose first event is at `anchor`.
    pub(super) fn new(
        central: AdapterId,
        peripheral: AdapterId,
        anchor: Duration,
        interval: Duration,
    ) -> Self {
        Self {
            sides: [Side::new(central), Side::new(peripheral)],
            channels: BTreeMap::new(),
            created_at: anchor,
            anchor,
            interval,
            period: interval,
            next_interval: None,
            exchange: None,
            is_peripheral_listening: false,
            is_event_lost: false,
            losses_in_row: 0,
            setup_events_left: SETUP_EVENTS,
            is_terminating: false,
        }
    }

    /// Returns the side of that adapter.
    pub(super) fn side_of(&self, adapter: AdapterId) -> Option<usize> {
        self.sides.iter().position(|side| side.adapter == adapter)
    }

    /// Returns whether an exchange in progress uses the radio of `side`.
    pub(super) fn is_using_radio(&self, side: usize) -> bool {
        self.exchange.is_some() && (side == CENTRAL || self.is_peripheral_listening)
    }

    /// Returns whether both sides are up and have nothing to do but to confirm this in each event.
    pub(super) fn is_idle(&self) -> bool {
        self.is_quiet()
            && self.setup_events_left == 0
            && self.exchange.is_none()
            && self.sides.iter().all(|side| side.is_up)
    }

    /// Returns the time at which `side` drops the connection unless it receives a packet before.
    pub(super) fn supervision_ends_at(&self, side: usize, options: &AirOptions) -> Duration {
        match self.sides[side].last_received {
            Some(last_received) => last_received + options.supervision_timeout,
            None => self.created_at + ESTABLISH_INTERVALS * self.interval,
        }
    }

    /// Records that `side` received a packet at `now`.
    pub(super) fn on_received(&mut self, side: usize, now: Duration) {
        self.sides[side].last_received = Some(now);
    }

    /// Handles the end of an event in which the central received a packet of the peripheral.
    ///
    /// Returns the interval to which both sides change now, if there is one.
    pub(super) fn on_good_event(&mut self) -> Option<Duration> {
        self.setup_events_left = self.setup_events_left.saturating_sub(1);
        let (interval, events_left) = self.next_interval?;
        if events_left > 1 {
            self.next_interval = Some((interval, events_left - 1));
            return None;
        }
        self.next_interval = None;
        self.interval = interval;
        Some(interval)
    }

    /// Announces another interval to the peripheral.
    pub(super) fn update_interval(&mut self, interval: Duration) {
        if interval != self.interval || self.next_interval.is_some() {
            self.next_interval = Some((interval, UPDATE_EVENTS));
        }
    }

    /// Queues a signalling command at `side`. Signalling commands are sent before data.
    pub(super) fn signal(&mut self, side: usize, signal: Signal) {
        self.sides[side].signals.push_back(signal);
    }

    /// Queues credits for a channel at `side`, if they are due.
    pub(super) fn return_credits(&mut self, side: usize, channel: ChannelId) {
        let due = self
            .channels
            .get_mut(&channel)
            .and_then(|end| end.due_credits(side));
        if let Some(frames) = due {
            self.signal(side, Signal::Credits { channel, frames });
        }
    }

    /// Returns whether `side` has an unacknowledged packet or more to send.
    pub(super) fn has_data(&self, side: usize) -> bool {
        match &self.sides[side].in_flight {
            // The central knows that its packet arrived only when it receives the response. The peripheral learns it in
            // the next event at the latest; an event does not continue for that alone.
            Some(packet) if side == CENTRAL || !packet.is_delivered => true,
            _ => self.has_more(side),
        }
    }

    /// Returns whether nothing is in flight or queued, so that events only confirm that both sides are in range.
    pub(super) fn is_quiet(&self) -> bool {
        let has_nothing = |side: usize| {
            let this = &self.sides[side];
            this.in_flight.is_none()
                && this.frame.is_none()
                && this.signals.is_empty()
                && !self.channels.values().any(|channel| channel.is_ready(side))
        };
        !self.is_terminating
            && self.next_interval.is_none()
            && has_nothing(CENTRAL)
            && has_nothing(PERIPHERAL)
    }

    /// Returns whether `side` has more to send than the packet in flight.
    pub(super) fn has_more(&self, side: usize) -> bool {
        let this = &self.sides[side];
        if self.setup_events_left > 0 || !this.is_up {
            return false;
        }
        this.frame.is_some()
            || !this.signals.is_empty()
            || self.channels.values().any(|channel| channel.is_ready(side))
    }

    /// Returns the maximum size of the next packet of `side`, in bytes; 0 for an empty packet.
    pub(super) fn next_bytes(&self, side: usize, payload_bytes: usize) -> usize {
        match &self.sides[side].in_flight {
            Some(packet) if side == CENTRAL || !packet.is_delivered => packet.bytes,
            _ if self.has_more(side) => payload_bytes,
            _ => 0,
        }
    }

    /// Puts the next packet of `side` in flight, unless one is in flight. Returns its size in bytes and whether it was
    /// sent before.
    pub(super) fn start_transmission(
        &mut self,
        side: usize,
        payload_bytes: usize,
    ) -> (usize, bool) {
        if self.sides[side].in_flight.is_none() {
            self.sides[side].in_flight = self.next_packet(side, payload_bytes);
        }
        match &mut self.sides[side].in_flight {
            Some(packet) => {
                let was_sent = std::mem::replace(&mut packet.is_repeated, true);
                (packet.bytes, was_sent)
            }
            None => (0, false),
        }
    }

    fn next_packet(&mut self, side: usize, payload_bytes: usize) -> Option<Packet> {
        if !self.has_more(side) {
            return None;
        }
        let frame = match self.sides[side].frame.take() {
            Some(frame) => frame,
            None => self.next_frame(side)?,
        };
        let (packet, rest) = frame.cut(payload_bytes);
        self.sides[side].frame = rest;
        Some(packet)
    }

    fn next_frame(&mut self, side: usize) -> Option<Frame> {
        if let Some(signal) = self.sides[side].signals.pop_front() {
            return Some(Frame::of_signal(signal));
        }
        let last_served = self.sides[side].last_served;
        let mut ready = self
            .channels
            .iter()
            .filter(|(_, channel)| channel.is_ready(side))
            .map(|(id, _)| *id);
        let first = ready.clone().next()?;
        let id = ready.find(|id| *id > last_served).unwrap_or(first);
        self.sides[side].last_served = id;
        let piece = self.channels.get_mut(&id)?.cut(side)?;
        Some(Frame::of_piece(id, piece))
    }

    /// Returns the number of bytes queued at `side`, for the status.
    pub(super) fn queued_bytes(&self, side: usize) -> usize {
        self.channels
            .values()
            .map(|channel| channel.queued_bytes(side))
            .sum()
    }
}

impl Side {
    fn new(adapter: AdapterId) -> Self {
        Self {
            adapter,
            is_up: true,
            last_event: Duration::ZERO,
            last_received: None,
            signals: VecDeque::new(),
            frame: None,
            in_flight: None,
            last_served: ChannelId(0),
        }
    }

    /// Closes this side and discards everything it still had to send.
    pub(super) fn shut_down(&mut self) {
        self.is_up = false;
        self.signals.clear();
        self.frame = None;
        self.in_flight = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{message::RequestId, packet::PacketContent};

    fn new() -> Connection {
        let interval = Duration::from_millis(30);
        Connection::new(AdapterId(1), AdapterId(2), Duration::ZERO, interval)
    }

    fn connection(channels: u64) -> Connection {
        let mut connection = new();
        for _ in 0..SETUP_EVENTS {
            connection.on_good_event();
        }
        for id in 1..=channels {
            let mut channel = Channel::opening(CENTRAL, RequestId(1), 1000, 247, 2000);
            channel.accept(PERIPHERAL, 1000);
            channel.confirm(CENTRAL);
            connection.channels.insert(ChannelId(id), channel);
        }
        connection
    }

    fn send(connection: &mut Connection, channel: u64, bytes: usize) {
        let channel = connection.channels.get_mut(&ChannelId(channel));
        let queued = channel.expect("open").queue(CENTRAL, vec![1; bytes]);
        queued.expect("room");
    }

    fn packets(connection: &mut Connection, payload_bytes: usize) -> Vec<Packet> {
        std::iter::from_fn(|| {
            connection.start_transmission(CENTRAL, payload_bytes);
            connection.sides[CENTRAL].in_flight.take()
        })
        .collect()
    }

    #[test]
    fn splits_a_frame_of_247_bytes_into_one_long_or_ten_short_packets() {
        let mut connection = connection(1);
        send(&mut connection, 1, 245);
        let long: Vec<_> = packets(&mut connection, 251)
            .iter()
            .map(|p| p.bytes)
            .collect();
        assert_eq!(long, [251]);
        send(&mut connection, 1, 245);
        let short = packets(&mut connection, 27);
        assert_eq!(short.len(), 10);
        assert_eq!(short[9].bytes, 251 - 9 * 27);
        assert_eq!(short[0].completes, Some((ChannelId(1), 27 - 6)));
        let done = short.iter().filter_map(|packet| packet.completes);
        assert_eq!(done.map(|(_, bytes)| bytes).sum::<usize>(), 245);
        assert!(short[8].content.is_none());
    }

    #[test]
    fn interleaves_channels_and_sends_signals_first() {
        let mut connection = connection(2);
        for id in [1, 1, 2, 2] {
            send(&mut connection, id, 200);
        }
        let credits = Signal::Credits {
            channel: ChannelId(1),
            frames: 1,
        };
        connection.signal(CENTRAL, credits);
        let order: Vec<_> = packets(&mut connection, 251)
            .into_iter()
            .map(|packet| match packet.content {
                Some(PacketContent::Signal(_)) => 0,
                Some(PacketContent::Frame { channel, .. }) => channel.0,
                None => panic!("one packet a frame"),
            })
            .collect();
        assert_eq!(order, [0, 1, 2, 1, 2]);
    }

    #[test]
    fn retransmits_a_packet_until_it_is_acknowledged() {
        let mut connection = connection(1);
        send(&mut connection, 1, 100);
        assert_eq!(connection.start_transmission(CENTRAL, 251), (106, false));
        assert_eq!(connection.start_transmission(CENTRAL, 251), (106, true));
        assert!(connection.has_data(CENTRAL));
        assert!(!connection.has_data(PERIPHERAL));
    }

    #[test]
    fn sends_no_data_during_link_set_up() {
        let mut connection = new();
        let disconnect = Signal::Disconnect {
            channel: ChannelId(1),
        };
        connection.signal(CENTRAL, disconnect);
        assert_eq!(connection.start_transmission(CENTRAL, 251), (0, false));
    }
}
