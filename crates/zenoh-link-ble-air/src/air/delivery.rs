//! Handles the arrival of packets, and the loss of connections.
use zenoh_link_ble_radio::address::Psm;

use super::{Air, ConnectionId};

use crate::{
    channel::EndState,
    connection::CENTRAL,
    id::AdapterId,
    message::{ChannelId, ConnectFailure, Event},
    packet::{PacketContent, Signal},
};

impl Air {
    /// Delivers the packet in flight from `side` to the other side.
    pub(super) fn deliver(&mut self, id: ConnectionId, side: usize) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let Some(packet) = &mut connection.sides[side].in_flight else {
            return;
        };
        // A retransmitted packet whose acknowledgement was lost arrives twice; the duplicate is dropped.
        let is_new = !std::mem::replace(&mut packet.is_delivered, true);
        let receiver = 1 - side;
        match packet.content.take() {
            None => {}
            Some(PacketContent::Signal(signal)) => self.on_signal(id, receiver, signal),
            Some(PacketContent::Frame { channel, sdu }) => {
                self.on_frame(id, receiver, channel, sdu)
            }
        }
        if is_new {
            self.count_down_to_cut();
        }
    }

    /// Counts an arrived packet for [`Air::cut_after`].
    fn count_down_to_cut(&mut self) {
        if let Some(left) = &mut self.cut_after {
            *left -= 1;
            if *left == 0 {
                self.cut_after = None;
                self.is_cut = true;
            }
        }
    }

    /// Handles the acknowledgement of the packet in flight from `side`.
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
        if end.is_some_and(|end| end.on_acknowledged(side, bytes)) {
            self.emit(adapter, Event::Sent { channel, bytes });
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
        if !end.on_frame(side, sdu.is_some()) {
            return;
        }
        connection.return_credits(side, channel);
        let adapter = connection.sides[side].adapter;
        if let Some(sdu) = sdu {
            self.emit(adapter, Event::Received { channel, sdu });
        }
    }

    fn on_signal(&mut self, id: ConnectionId, side: usize, signal: Signal) {
        match signal {
            Signal::ConnectRequest { channel, psm } => {
                self.on_connect_request(id, side, channel, psm);
            }
            Signal::ConnectResponse { channel, accepted } => {
                self.on_connect_response(id, side, channel, accepted);
            }
            Signal::Disconnect { channel } => {
                let Some(connection) = self.connections.get_mut(&id) else {
                    return;
                };
                let adapter = connection.sides[side].adapter;
                let end = connection.channels.get_mut(&channel);
                if end.map(|end| end.close(side)) == Some(EndState::Open) {
                    self.emit(adapter, Event::Closed { channel });
                }
                self.remove_if_finished(channel);
            }
            Signal::Credits { channel, frames } => {
                let connection = self.connections.get_mut(&id);
                let end = connection.and_then(|c| c.channels.get_mut(&channel));
                if let Some(end) = end {
                    end.on_credits(side, frames);
                }
            }
        }
    }

    fn on_connect_request(&mut self, id: ConnectionId, side: usize, channel: ChannelId, psm: Psm) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        let (local, remote) = (
            connection.sides[side].adapter,
            connection.sides[1 - side].adapter,
        );
        let recv_mtu = self
            .adapters
            .get(&local)
            .and_then(|adapter| adapter.listeners.get(&psm.number()));
        let peer = self.adapters.get(&remote).map(|adapter| adapter.address);
        // The requesting end may have cancelled in the meantime; then the channel no longer exists.
        let Some(end) = connection.channels.get_mut(&channel) else {
            return;
        };
        let accepted = match (recv_mtu, peer) {
            (Some(recv_mtu), Some(peer)) => {
                end.accept(side, *recv_mtu);
                let limits = end.send_limits(side);
                self.events.push(super::TimedEvent {
                    at: self.now,
                    adapter: local,
                    event: Event::Incoming {
                        channel,
                        psm,
                        peer,
                        limits,
                        is_central: side == CENTRAL,
                    },
                });
                true
            }
            _ => false,
        };
        connection.signal(side, Signal::ConnectResponse { channel, accepted });
    }

    fn on_connect_response(
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
                is_central: side == CENTRAL,
            };
            self.emit(adapter, event);
        } else {
            end.close(side);
            let why = ConnectFailure::Refused;
            self.emit(adapter, Event::ConnectFailed { request, why });
            self.remove_if_finished(channel);
        }
    }

    /// Drops the connection at `side`: its supervision timeout expired, or it received the other side's termination.
    pub(super) fn drop_side(&mut self, id: ConnectionId, side: usize) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        connection.sides[side].shut_down();
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
                    self.emit(adapter, Event::ConnectFailed { request, why });
                }
                EndState::Open => self.emit(adapter, Event::Closed { channel }),
                EndState::Unaware | EndState::Closed => {}
            }
        }
        self.remove_if_down(id);
    }

    /// Removes an adapter from all its connections, with a termination if `is_orderly`. The adapter itself receives no
    /// events.
    pub(super) fn leave_connections(&mut self, adapter: AdapterId, is_orderly: bool) {
        let ids: Vec<_> = self.connections.keys().copied().collect();
        for id in ids {
            let Some(connection) = self.connections.get_mut(&id) else {
                continue;
            };
            let Some(side) = connection.side_of(adapter) else {
                continue;
            };
            connection.sides[side].shut_down();
            connection.is_terminating |= is_orderly;
            for channel in connection.channels.values_mut() {
                channel.close(side);
            }
            self.remove_if_down(id);
        }
    }

    fn remove_if_down(&mut self, id: ConnectionId) {
        let is_down = self
            .connections
            .get(&id)
            .is_some_and(|c| c.sides.iter().all(|side| !side.is_up));
        if is_down {
            self.connections.remove(&id);
            self.channel_connections.retain(|_, home| *home != id);
        }
    }

    /// Removes a closed channel. A connection without channels stays open, as with bluetoothd, until one side closes it.
    pub(super) fn remove_if_finished(&mut self, channel: ChannelId) {
        let Some(id) = self.channel_connections.get(&channel).copied() else {
            return;
        };
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        if connection
            .channels
            .get(&channel)
            .is_some_and(|end| end.is_finished())
        {
            connection.channels.remove(&channel);
            self.channel_connections.remove(&channel);
        }
    }
}
