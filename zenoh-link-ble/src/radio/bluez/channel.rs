//! Owns channels on kernel sockets: taking them, opening them, moving SDUs.
use std::sync::Arc;

use async_trait::async_trait;
use bluer::l2cap::{SeqPacket, SeqPacketListener};

use super::{
    device_address,
    errors::{connect_error, socket_error},
    packets::Packets,
    socket::{bound, connect},
};
use crate::{
    address::{DeviceAddress, Psm},
    radio::{Channel, ChannelListener, ChannelOptions, RadioError},
};

/// Incoming channels the kernel holds until they are taken.
const BACKLOG: u32 = 8;
/// How much of a socket's receive buffer a byte of an SDU takes at most, where it is counted with 24 bytes more
/// (`PER_SDU`): the kernel takes some 770 bytes for a K-frame, and K-frames have 23 bytes where packets have 27.
const BUFFER_PER_BYTE: usize = 34;

pub(super) struct BluezListener {
    adapter: String,
    psm: Psm,
    socket: SeqPacketListener,
}

impl BluezListener {
    pub(super) fn start(
        adapter: &str,
        own: DeviceAddress,
        psm: Option<Psm>,
        options: ChannelOptions,
    ) -> Result<Self, RadioError> {
        let failed = socket_error("listen", adapter, psm);
        let socket = bound(own, psm, options)
            .and_then(|socket| socket.listen(BACKLOG))
            .map_err(&failed)?;
        let taken = socket.as_ref().local_addr().map_err(&failed)?;
        let psm = Psm::new(taken.psm).ok_or_else(|| RadioError::System {
            action: "listen",
            source: format!("the kernel chose psm {}", taken.psm).into(),
        })?;
        Ok(Self {
            adapter: adapter.to_owned(),
            psm,
            socket,
        })
    }
}

#[async_trait]
impl ChannelListener for BluezListener {
    fn psm(&self) -> Psm {
        self.psm
    }

    async fn accept(&self) -> Result<Arc<dyn Channel>, RadioError> {
        let failed = socket_error("take a channel", &self.adapter, None);
        loop {
            let (socket, from) = self.socket.accept().await.map_err(&failed)?;
            let peer = device_address(from.addr, from.addr_type);
            match BluezChannel::new(&self.adapter, peer, &socket) {
                Ok(channel) => return Ok(Arc::new(channel)),
                // It does not concern the listener that one peer has closed its channel again.
                Err(error) => tracing::debug!("ble: {peer} closed its channel at once: {error}"),
            }
        }
    }
}

pub(super) struct BluezChannel {
    adapter: String,
    peer: DeviceAddress,
    send_mtu: usize,
    kept_unread_bytes: usize,
    packets: Packets,
}

impl BluezChannel {
    pub(super) async fn connect(
        adapter: &str,
        own: DeviceAddress,
        peer: DeviceAddress,
        psm: Psm,
        options: ChannelOptions,
    ) -> Result<Self, RadioError> {
        let socket = bound(own, None, options).map_err(socket_error("connect", adapter, None))?;
        let socket = connect(socket, peer, psm)
            .await
            .map_err(|error| connect_error(peer, psm, error))?;
        Self::new(adapter, peer, &socket)
    }

    fn new(adapter: &str, peer: DeviceAddress, socket: &SeqPacket) -> Result<Self, RadioError> {
        let send_mtu = socket.send_mtu().map_err(|error| down(peer, error))?;
        let packets = Packets::of(socket).map_err(|error| down(peer, error))?;
        let receive_buffer_bytes = packets
            .widen_receive_buffer()
            .map_err(|error| down(peer, error))?;
        Ok(Self {
            adapter: adapter.to_owned(),
            peer,
            send_mtu,
            kept_unread_bytes: receive_buffer_bytes / BUFFER_PER_BYTE,
            packets,
        })
    }
}

#[async_trait]
impl Channel for BluezChannel {
    fn peer(&self) -> DeviceAddress {
        self.peer
    }

    fn adapter(&self) -> &str {
        &self.adapter
    }

    fn send_mtu(&self) -> usize {
        self.send_mtu
    }

    fn kept_unread_bytes(&self) -> usize {
        self.kept_unread_bytes
    }

    fn try_send(&self, sdu: &[u8]) -> Result<bool, RadioError> {
        if sdu.len() > self.send_mtu {
            return Err(RadioError::SduTooLarge {
                size: sdu.len(),
                limit: self.send_mtu,
            });
        }
        match self.packets.try_send(sdu) {
            Ok(sent) if sent == sdu.len() => Ok(true),
            Ok(sent) => {
                let cut = format!("{sent} of {} bytes of an sdu sent", sdu.len());
                Err(down(self.peer, std::io::Error::other(cut)))
            }
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => Ok(false),
            Err(error) => Err(down(self.peer, error)),
        }
    }

    async fn has_room(&self) {
        self.packets.has_room().await;
    }

    async fn recv(&self, buffer: &mut [u8]) -> Result<usize, RadioError> {
        let size = self
            .packets
            .recv(buffer)
            .await
            .map_err(|error| down(self.peer, error))?;
        if size == 0 {
            return Err(RadioError::ChannelDown {
                peer: self.peer,
                source: None,
            });
        }
        Ok(size)
    }

    fn shutdown(&self) {
        self.packets.shutdown();
    }
}

fn down(peer: DeviceAddress, error: std::io::Error) -> RadioError {
    RadioError::ChannelDown {
        peer,
        source: Some(error),
    }
}
