//! Handles the commands of adapters. Every command is checked: the adapter may belong to a faulty process.
use std::time::Duration;
use zenoh_link_ble_radio::{
    address::{DeviceAddress, Psm},
    advertisement::Advertisement,
};

use super::{timers::Timer, Air};

use crate::{
    adapter::{Advertising, Dial, MAX_REQUESTS},
    connection::Connection,
    id::{AdapterId, ConnectionId},
    message::{ChannelId, Command, ConnectFailure, Event, ListenFailure, RequestId, Violation},
    options::{ADVERTISING_DELAY, MAX_NAME_BYTES, MIN_MTU},
    packet::Signal,
};

impl Air {
    /// Handles a command of an adapter. A command is ignored if an event that crossed it made it pointless.
    ///
    /// # Errors
    /// Returns a violation if no correct adapter would send the command.
    pub fn command(
        &mut self,
        id: AdapterId,
        command: Command,
        now: Duration,
    ) -> Result<(), Violation> {
        self.poll(now);
        match command {
            Command::Advertise {
                request,
                advertisement,
                name,
            } => self.advertise(id, request, advertisement, name),
            Command::StopAdvertising { request } => {
                if let Some(adapter) = self.adapters.get_mut(&id) {
                    adapter.advertisements.remove(&request);
                }
                Ok(())
            }
            Command::Scan(is_on) => {
                self.begin_to_receive(id);
                if let Some(adapter) = self.adapters.get_mut(&id) {
                    adapter.scan = (is_on && adapter.is_on()).then(Default::default);
                }
                Ok(())
            }
            Command::Listen {
                request,
                psm,
                recv_mtu,
            } => self.listen(id, request, psm, recv_mtu),
            Command::Unlisten { psm } => {
                if let Some(adapter) = self.adapters.get_mut(&id) {
                    adapter.listeners.remove(&psm.number());
                }
                Ok(())
            }
            Command::Connect {
                request,
                peer,
                psm,
                recv_mtu,
            } => self.connect(id, request, peer, psm, recv_mtu),
            Command::CancelConnect { request } => {
                self.cancel(id, request);
                Ok(())
            }
            Command::Send { channel, sdu } => self.send(id, channel, sdu),
            Command::SduRead { channel } => self.on_sdu_read(id, channel),
            Command::SetInterval { peer, units } => self.set_interval(id, peer, units),
            Command::Close { channel } => {
                self.close(id, channel);
                Ok(())
            }
            Command::Disconnect { peer } => {
                self.disconnect(id, peer);
                Ok(())
            }
        }
    }

    fn advertise(
        &mut self,
        id: AdapterId,
        request: RequestId,
        advertisement: Advertisement,
        name: String,
    ) -> Result<(), Violation> {
        check_psm(advertisement.psm)?;
        if name.len() > MAX_NAME_BYTES {
            return Err(Violation::Name);
        }
        let next = self.now + self.rng.random_duration(ADVERTISING_DELAY);
        let Some(adapter) = self.adapters.get_mut(&id).filter(|a| a.is_on()) else {
            return Ok(());
        };
        check_free(&adapter.advertisements, &request)?;
        let advertising = Advertising {
            advertisement,
            name,
            next,
            event: None,
        };
        adapter.advertisements.insert(request, advertising);
        self.schedule(Timer::Advertise(id, request));
        Ok(())
    }

    fn listen(
        &mut self,
        id: AdapterId,
        request: RequestId,
        psm: Option<Psm>,
        recv_mtu: u16,
    ) -> Result<(), Violation> {
        psm.map_or(Ok(()), check_psm)?;
        check_mtu(recv_mtu)?;
        let Some(adapter) = self.adapters.get_mut(&id) else {
            return Ok(());
        };
        let psm = if !adapter.is_on() {
            Err(ListenFailure::Unavailable)
        } else if let Some(psm) = psm {
            let is_taken = adapter.listeners.contains_key(&psm.number());
            (!is_taken).then_some(psm).ok_or(ListenFailure::Taken)
        } else {
            (Psm::MIN..=Psm::MAX)
                .filter(|number| !adapter.listeners.contains_key(number))
                .find_map(Psm::new)
                .ok_or(ListenFailure::NoneFree)
        };
        if let Ok(psm) = psm {
            adapter.listeners.insert(psm.number(), recv_mtu);
        }
        self.emit(id, Event::Listening { request, psm });
        Ok(())
    }

    fn connect(
        &mut self,
        id: AdapterId,
        request: RequestId,
        peer: DeviceAddress,
        psm: Psm,
        recv_mtu: u16,
    ) -> Result<(), Violation> {
        check_psm(psm)?;
        check_mtu(recv_mtu)?;
        let Some(adapter) = self.adapters.get(&id) else {
            return Ok(());
        };
        check_free(&adapter.dials, &request)?;
        if !adapter.is_on() {
            let why = ConnectFailure::Unavailable;
            self.emit(id, Event::ConnectFailed { request, why });
            return Ok(());
        }
        let dial = Dial {
            peer,
            psm,
            recv_mtu,
        };
        let connection = self.connection_to(id, peer).filter(|connection| {
            let connection = self.connections.get(connection);
            connection.is_some_and(|c| c.sides.iter().all(|side| side.is_up))
        });
        match connection {
            Some(connection) => self.open(connection, id, request, dial),
            None => {
                self.begin_to_receive(id);
                if let Some(adapter) = self.adapters.get_mut(&id) {
                    adapter.dials.insert(request, dial);
                }
            }
        }
        Ok(())
    }

    /// Returns the adapter's connection to the device with that address.
    pub(super) fn connection_to(&self, id: AdapterId, peer: DeviceAddress) -> Option<ConnectionId> {
        let is_peer = |other: &AdapterId| {
            let adapter = self.adapters.get(other);
            *other != id && adapter.is_some_and(|adapter| adapter.address == peer)
        };
        let other = self.adapters.keys().copied().find(is_peer)?;
        self.connection_between(id, other)
    }

    /// Records that the adapter begins to scan, unless it is scanning already.
    fn begin_to_receive(&mut self, id: AdapterId) {
        let now = self.now;
        if let Some(adapter) = self.adapters.get_mut(&id) {
            if !adapter.receives_advertisements() {
                adapter.receiving_since = now;
            }
        }
    }

    fn cancel(&mut self, id: AdapterId, request: RequestId) {
        if let Some(adapter) = self.adapters.get_mut(&id) {
            adapter.dials.remove(&request);
        }
        let opening = self.connections.values().find_map(|connection| {
            let side = connection.side_of(id)?;
            let asked = connection
                .channels
                .iter()
                .find(|(_, channel)| channel.is_opening(side, request));
            asked.map(|(channel, _)| *channel)
        });
        if let Some(channel) = opening {
            self.close(id, channel);
        }
    }

    fn send(&mut self, id: AdapterId, channel: ChannelId, sdu: Vec<u8>) -> Result<(), Violation> {
        let Some((connection, side)) = self.connection_of_channel(id, channel) else {
            return Ok(());
        };
        let bytes = sdu.len() as u64;
        match connection.channels.get_mut(&channel) {
            Some(channel) if channel.is_open(side) => channel.queue(side, sdu)?,
            _ => return Ok(()),
        }
        if let Some(stats) = self.stats_mut(id) {
            stats.sdus += 1;
            stats.sdu_bytes += bytes;
        }
        Ok(())
    }

    fn on_sdu_read(&mut self, id: AdapterId, channel: ChannelId) -> Result<(), Violation> {
        let Some((connection, side)) = self.connection_of_channel(id, channel) else {
            return Ok(());
        };
        if let Some(end) = connection.channels.get_mut(&channel) {
            end.on_sdu_read(side)?;
        }
        connection.return_credits(side, channel);
        Ok(())
    }

    fn close(&mut self, id: AdapterId, channel: ChannelId) {
        let Some((connection, side)) = self.connection_of_channel(id, channel) else {
            return;
        };
        let Some(end) = connection.channels.get_mut(&channel) else {
            return;
        };
        if end.is_closed(side) {
            return;
        }
        end.close(side);
        if !end.is_finished() {
            connection.signal(side, Signal::Disconnect { channel });
        }
        self.remove_if_finished(channel);
    }

    /// Closes the adapter's side of a connection. The other side receives the termination at the next event that succeeds.
    fn disconnect(&mut self, id: AdapterId, peer: DeviceAddress) {
        let Some(connection_id) = self.connection_to(id, peer) else {
            return;
        };
        let Some(connection) = self.connections.get_mut(&connection_id) else {
            return;
        };
        if let Some(side) = connection
            .side_of(id)
            .filter(|side| connection.sides[*side].is_up)
        {
            connection.is_terminating = true;
            self.drop_side(connection_id, side);
        }
    }

    /// Returns the connection of a channel, and the adapter's side of it.
    fn connection_of_channel(
        &mut self,
        id: AdapterId,
        channel: ChannelId,
    ) -> Option<(&mut Connection, usize)> {
        let connection = self.channel_connections.get(&channel)?;
        let connection = self.connections.get_mut(connection)?;
        let side = connection.side_of(id)?;
        Some((connection, side))
    }
}

fn check_psm(psm: Psm) -> Result<(), Violation> {
    // A PSM in a received message was not created by `Psm::new`.
    Psm::new(psm.number()).map(drop).ok_or(Violation::Psm)
}

fn check_mtu(recv_mtu: u16) -> Result<(), Violation> {
    if recv_mtu < MIN_MTU {
        return Err(Violation::Mtu);
    }
    Ok(())
}

fn check_free<T>(
    pending: &std::collections::BTreeMap<RequestId, T>,
    request: &RequestId,
) -> Result<(), Violation> {
    if pending.contains_key(request) {
        return Err(Violation::DuplicateRequest);
    }
    if pending.len() >= MAX_REQUESTS {
        return Err(Violation::TooManyRequests);
    }
    Ok(())
}
