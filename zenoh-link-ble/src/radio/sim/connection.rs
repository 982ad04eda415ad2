//! Owns one LE connection between two adapters: what each side has to send, cut into link-layer packets, and which
//! packet is next. When packets meet on the air, and what becomes of them, is the air's business.
use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use super::{
    air::AdapterId,
    channel::Channel,
    message::ChannelId,
    options::{AirOptions, ESTABLISH_INTERVALS, SETUP_EVENTS},
    packet::{Frame, Packet, Signal},
};

/// The central's side of a connection: it sends first in every event.
pub(super) const CENTRAL: usize = 0;
/// The peripheral's side.
pub(super) const PERIPHERAL: usize = 1;

/// An LE connection.
#[derive(Debug)]
pub(super) struct Connection {
    pub(super) sides: [Side; 2],
    pub(super) channels: BTreeMap<ChannelId, Channel>,
    /// When its first event began.
    born: Duration,
    /// When the next event begins.
    pub(super) anchor: Duration,
    /// The exchange that is on the air now.
    pub(super) exchange: Option<Exchange>,
    /// When its last event began.
    pub(super) last_turn: Duration,
    /// Interference covers the event under way.
    pub(super) event_hit: bool,
    /// Packets lost in a row in the event under way; the second ends it.
    pub(super) losses_in_row: u8,
    /// Events that still go to the controllers' own procedures.
    setup_events_left: u8,
    /// Since when it has had no channel.
    pub(super) idle_since: Option<Duration>,
    /// One side left in good order; the other is told at the next event that works.
    pub(super) is_terminating: bool,
}

/// One side of a connection.
#[derive(Debug)]
pub(super) struct Side {
    pub(super) adapter: AdapterId,
    /// Whether this side still holds the connection.
    pub(super) is_up: bool,
    heard: Option<Duration>,
    signals: VecDeque<Signal>,
    frame: Option<Frame>,
    /// The packet sent last, until it is known to have arrived.
    pub(super) in_flight: Option<Packet>,
    /// The channel served last; the next one has its turn.
    served: ChannelId,
}

/// Two packets on the air.
#[derive(Debug)]
pub(super) struct Exchange {
    pub(super) ends_at: Duration,
    /// Whether each side's packet is heard by the other.
    pub(super) is_heard: [bool; 2],
}

impl Connection {
    /// A connection whose first event is at `anchor`.
    pub(super) fn new(central: AdapterId, peripheral: AdapterId, anchor: Duration) -> Self {
        Self {
            sides: [Side::new(central), Side::new(peripheral)],
            channels: BTreeMap::new(),
            born: anchor,
            anchor,
            exchange: None,
            last_turn: Duration::ZERO,
            event_hit: false,
            losses_in_row: 0,
            setup_events_left: SETUP_EVENTS,
            idle_since: None,
            is_terminating: false,
        }
    }

    /// The side of that adapter.
    pub(super) fn side_of(&self, adapter: AdapterId) -> Option<usize> {
        self.sides.iter().position(|side| side.adapter == adapter)
    }

    /// Whether one of the two radios is one of the other connection's.
    pub(super) fn shares_radio(&self, other: &Self) -> bool {
        self.sides
            .iter()
            .any(|side| other.side_of(side.adapter).is_some())
    }

    /// When `side` gives the connection up, if it hears nothing until then.
    pub(super) fn gives_up_at(&self, side: usize, options: &AirOptions) -> Duration {
        match self.sides[side].heard {
            Some(heard) => heard + options.supervision_timeout,
            None => self.born + ESTABLISH_INTERVALS * options.interval,
        }
    }

    /// `side` heard the other at `now`.
    pub(super) fn on_heard(&mut self, side: usize, now: Duration) {
        self.sides[side].heard = Some(now);
    }

    /// An event in which the central heard its peripheral is over.
    pub(super) fn on_good_event(&mut self) {
        self.setup_events_left = self.setup_events_left.saturating_sub(1);
    }

    /// Queues a signalling command at `side`; it goes before data.
    pub(super) fn signal(&mut self, side: usize, signal: Signal) {
        self.sides[side].signals.push_back(signal);
    }

    /// Sends credits for a channel from `side`, if it is time to.
    pub(super) fn return_credits(&mut self, side: usize, channel: ChannelId) {
        let due = self
            .channels
            .get_mut(&channel)
            .and_then(|end| end.due_credits(side));
        if let Some(frames) = due {
            self.signal(side, Signal::Credits { channel, frames });
        }
    }

    /// Whether `side` has a packet that is not known to have arrived, or more to send.
    pub(super) fn has_data(&self, side: usize) -> bool {
        match &self.sides[side].in_flight {
            // The central cannot know that its packet arrived before the answer was heard; the peripheral hears it in
            // the next event at the latest, for which alone no event goes on.
            Some(packet) if side == CENTRAL || !packet.is_delivered => true,
            _ => self.has_more(side),
        }
    }

    /// Whether nothing is on its way or waits for it, so that events bring nothing but that both are still there.
    pub(super) fn is_quiet(&self) -> bool {
        let has_nothing = |side: usize| {
            let this = &self.sides[side];
            this.in_flight.is_none()
                && this.frame.is_none()
                && this.signals.is_empty()
                && !self.channels.values().any(|channel| channel.is_ready(side))
        };
        !self.is_terminating && has_nothing(CENTRAL) && has_nothing(PERIPHERAL)
    }

    /// Whether `side` has more to send than what is in flight.
    pub(super) fn has_more(&self, side: usize) -> bool {
        let this = &self.sides[side];
        if self.setup_events_left > 0 || !this.is_up {
            return false;
        }
        this.frame.is_some()
            || !this.signals.is_empty()
            || self.channels.values().any(|channel| channel.is_ready(side))
    }

    /// The size of the packet that `side` would send next, at most; 0 for an empty one.
    pub(super) fn next_bytes(&self, side: usize, payload_bytes: usize) -> usize {
        match &self.sides[side].in_flight {
            Some(packet) if side == CENTRAL || !packet.is_delivered => packet.bytes,
            _ if self.has_more(side) => payload_bytes,
            _ => 0,
        }
    }

    /// Puts the next packet of `side` in flight, unless one is. Tells its size and whether it was sent before.
    pub(super) fn take_off(&mut self, side: usize, payload_bytes: usize) -> (usize, bool) {
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
        let served = self.sides[side].served;
        let mut ready = self
            .channels
            .iter()
            .filter(|(_, channel)| channel.is_ready(side))
            .map(|(id, _)| *id);
        let first = ready.clone().next()?;
        let id = ready.find(|id| *id > served).unwrap_or(first);
        self.sides[side].served = id;
        let piece = self.channels.get_mut(&id)?.cut(side)?;
        Some(Frame::of_piece(id, piece))
    }

    /// Bytes queued at `side`, for the status.
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
            heard: None,
            signals: VecDeque::new(),
            frame: None,
            in_flight: None,
            served: ChannelId(0),
        }
    }

    /// Throws away what this side still had to send.
    pub(super) fn silence(&mut self) {
        self.is_up = false;
        self.signals.clear();
        self.frame = None;
        self.in_flight = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::radio::sim::{message::RequestId, packet::Load};

    fn connection(channels: u64) -> Connection {
        let mut connection = Connection::new(AdapterId(1), AdapterId(2), Duration::ZERO);
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
            connection.take_off(CENTRAL, payload_bytes);
            connection.sides[CENTRAL].in_flight.take()
        })
        .collect()
    }

    #[test]
    fn a_frame_of_247_bytes_is_one_long_packet_or_ten_short_ones() {
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
        assert!(short[8].load.is_none());
    }

    #[test]
    fn channels_take_turns_and_signals_go_first() {
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
            .map(|packet| match packet.load {
                Some(Load::Signal(_)) => 0,
                Some(Load::Frame { channel, .. }) => channel.0,
                None => panic!("one packet a frame"),
            })
            .collect();
        assert_eq!(order, [0, 1, 2, 1, 2]);
    }

    #[test]
    fn a_packet_in_flight_stays_until_it_is_taken() {
        let mut connection = connection(1);
        send(&mut connection, 1, 100);
        assert_eq!(connection.take_off(CENTRAL, 251), (106, false));
        assert_eq!(connection.take_off(CENTRAL, 251), (106, true));
        assert!(connection.has_data(CENTRAL));
        assert!(!connection.has_data(PERIPHERAL));
    }

    #[test]
    fn nothing_is_sent_while_controllers_set_the_link_up() {
        let mut connection = Connection::new(AdapterId(1), AdapterId(2), Duration::ZERO);
        let disconnect = Signal::Disconnect {
            channel: ChannelId(1),
        };
        connection.signal(CENTRAL, disconnect);
        assert_eq!(connection.take_off(CENTRAL, 251), (0, false));
    }
}
