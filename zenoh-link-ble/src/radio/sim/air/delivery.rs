//! Owns what happens when packets arrive, and when they no longer do.
use super::{due::Due, Air, ConnectionId};
use crate::{
    address::Psm,
    radio::sim::{
        air::AdapterId,
        channel::EndState,
        message::{ChannelId, ConnectFailure, Event},
        packet::{Load, Signal},
    },
};

impl Air {
    /// The packet in flight from `side` was heard by the other.
    pub(super) fn deliver(&mut self, id: ConnectionId, side: usize) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let Some(packet) = &mut connection.sides[side].in_flight else {
            return;
        };
        // A repeated packet whose acknowledgement was lost arrives twice; the second one is dropped.
        let is_new = !std::mem::replace(&mut packet.is_delivered, true);
        let receiver = 1 - side;
        match packet.load.take() {
            None => {}
            Some(Load::Signal(signal)) => self.on_signal(id, receiver, signal),
            Some(Load::Frame { channel, sdu }) => self.on_frame(id, receiver, channel, sdu),
        }
        if is_new {
            self.count_down_to_cut();
        }
    }

    /// A packet has arrived; it may be the last one.
    fn count_down_to_cut(&mut self) {
        if let Some(left) = &mut self.cut_after {
            *left -= 1;
            if *left == 0 {
                self.cut_after = None;
                self.is_cut = true;
            }
        }
    }

    /// The packet in flight from `side` is known to have arrived.
    pub(super) fn acknowledge(&mut self, id: ConnectionId, side: usize) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let Some(packet) = connection.sides[side].in_flight.take_if(|p| p.is_delivered) else {
            return;
        };
        let Some((channel, bytes)) = packet.completes else {
            return;
        };
        let adapter = connection.sides[side].adapter;
        let end = connection.channels.get_mut(&channel);
        if end.is_some_and(|end| end.acknowledged(side, bytes)) {
            self.tell(adapter, Event::Sent { channel, bytes });
        }
    }

    fn on_frame(
        &mut self,
        id: ConnectionId,
        side: usize,
        channel: ChannelId,
        sdu: Option<Vec<u8>>,
    ) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let Some(end) = connection.channels.get_mut(&channel) else {
            return;
        };
        if !end.received(side, sdu.is_some()) {
            return;
        }
        connection.return_credits(side, channel);
        let adapter = connection.sides[side].adapter;
        if let Some(sdu) = sdu {
            self.tell(adapter, Event::Received { channel, sdu });
        }
    }

    fn on_signal(&mut self, id: ConnectionId, side: usize, signal: Signal) {
        match signal {
            Signal::ConnectRequest { channel, psm } => {
                self.on_connect_request(id, side, channel, psm);
            }
            Signal::ConnectAnswer { channel, accepted } => {
                self.on_connect_answer(id, side, channel, accepted);
            }
            Signal::Disconnect { channel } => {
                let Some(connection) = self.connections.get_mut(&id) else {
                    return;
                };
                let adapter = connection.sides[side].adapter;
                let end = connection.channels.get_mut(&channel);
                if end.map(|end| end.close(side)) == Some(EndState::Open) {
                    self.tell(adapter, Event::Closed { channel });
                }
                self.settle(channel);
            }
            Signal::Credits { channel, frames } => {
                let connection = self.connections.get_mut(&id);
                let end = connection.and_then(|c| c.channels.get_mut(&channel));
                if let Some(end) = end {
                    end.credited(side, frames);
                }
            }
        }
    }

    fn on_connect_request(&mut self, id: ConnectionId, side: usize, channel: ChannelId, psm: Psm) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let (here, there) = (
            connection.sides[side].adapter,
            connection.sides[1 - side].adapter,
        );
        let recv_mtu = self
            .adapters
            .get(&here)
            .and_then(|adapter| adapter.listeners.get(&psm.number()));
        let peer = self.adapters.get(&there).map(|adapter| adapter.address);
        // Whoever asked may have given up meanwhile; then there is no such channel any more.
        let Some(end) = connection.channels.get_mut(&channel) else {
            return;
        };
        let accepted = match (recv_mtu, peer) {
            (Some(recv_mtu), Some(peer)) => {
                end.accept(side, *recv_mtu);
                let limits = end.send_limits(side);
                self.events.push(super::Happened {
                    at: self.now,
                    adapter: here,
                    event: Event::Incoming {
                        channel,
                        psm,
                        peer,
                        limits,
                    },
                });
                true
            }
            _ => false,
        };
        connection.signal(side, Signal::ConnectAnswer { channel, accepted });
    }

    fn on_connect_answer(
        &mut self,
        id: ConnectionId,
        side: usize,
        channel: ChannelId,
        accepted: bool,
    ) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let adapter = connection.sides[side].adapter;
        let Some(end) = connection.channels.get_mut(&channel) else {
            return;
        };
        let EndState::Opening(request) = end.ends[side].state else {
            return;
        };
        if accepted {
            end.confirm(side);
            let limits = end.send_limits(side);
            let event = Event::Connected {
                request,
                channel,
                limits,
            };
            self.tell(adapter, event);
        } else {
            end.close(side);
            let why = ConnectFailure::Refused;
            self.tell(adapter, Event::ConnectFailed { request, why });
            self.settle(channel);
        }
    }

    /// `side` gives the connection up: it has heard nothing for too long, or was told that the other left.
    pub(super) fn drop_side(&mut self, id: ConnectionId, side: usize) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        connection.sides[side].silence();
        let adapter = connection.sides[side].adapter;
        let ends: Vec<_> = connection
            .channels
            .iter_mut()
            .map(|(channel, end)| (*channel, end.close(side)))
            .collect();
        for (channel, state) in ends {
            match state {
                EndState::Opening(request) => {
                    let why = ConnectFailure::LinkLost;
                    self.tell(adapter, Event::ConnectFailed { request, why });
                }
                EndState::Open => self.tell(adapter, Event::Closed { channel }),
                EndState::Unaware | EndState::Closed => {}
            }
        }
        self.forget_if_down(id);
    }

    /// An adapter leaves all its connections, in good order or without a word. Nothing is said to the adapter itself.
    pub(super) fn leave(&mut self, adapter: AdapterId, is_orderly: bool) {
        let ids: Vec<_> = self.connections.keys().copied().collect();
        for id in ids {
            let Some(connection) = self.connections.get_mut(&id) else {
                continue;
            };
            let Some(side) = connection.side_of(adapter) else {
                continue;
            };
            connection.sides[side].silence();
            connection.is_terminating |= is_orderly;
            for channel in connection.channels.values_mut() {
                channel.close(side);
            }
            self.forget_if_down(id);
        }
    }

    fn forget_if_down(&mut self, id: ConnectionId) {
        let is_down = self
            .connections
            .get(&id)
            .is_some_and(|c| c.sides.iter().all(|side| !side.is_up));
        if is_down {
            self.connections.remove(&id);
            self.homes.retain(|_, home| *home != id);
        }
    }

    /// Forgets a channel that neither end needs; a connection without channels goes soon.
    pub(super) fn settle(&mut self, channel: ChannelId) {
        let Some(id) = self.homes.get(&channel).copied() else {
            return;
        };
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        if connection
            .channels
            .get(&channel)
            .is_some_and(|end| end.is_over())
        {
            connection.channels.remove(&channel);
            self.homes.remove(&channel);
            if connection.channels.is_empty() {
                connection.idle_since = Some(self.now);
                self.plan(Due::LingerEnd(id));
            }
        }
    }
}
