//! Implements channels on kernel sockets: listening, connecting, sending and receiving SDUs.
use std::sync::Arc;

use async_trait::async_trait;
use bluer::l2cap::{SeqPacket, SeqPacketListener};
use zenoh_link_ble_radio::{
    address::{DeviceAddress, Psm},
    Channel, ChannelListener, ChannelOptions, RadioError,
};

use super::{
    device_address,
    errors::{connect_error, socket_error},
    role,
    sdu_socket::SduSocket,
    socket::{bind, connect},
};

/// Incoming channels that the kernel holds until they are accepted.
const BACKLOG: u32 = 8;
/// Receive buffer space, in bytes, that one byte of an SDU takes at most, if each SDU is counted with 24 additional
/// bytes (`SDU_OVERHEAD_BYTES`). The kernel takes about 770 bytes for a K-frame, and a K-frame carries 23 bytes if
/// packets have 27.
const BUFFER_BYTES_PER_SDU_BYTE: usize = 34;

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
        let socket = bind(own, psm, options)
            .and_then(|socket| socket.listen(BACKLOG))
            .map_err(&failed)?;
        let bound = socket.as_ref().local_addr().map_err(&failed)?;
        let psm = Psm::new(bound.psm).ok_or_else(|| RadioError::System {
            action: "listen",
            source: format!("the kernel chose psm {}", bound.psm).into(),
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
        let failed = socket_error("accept a channel", &self.adapter, None);
        loop {
            let (socket, from) = self.socket.accept().await.map_err(&failed)?;
            let peer = device_address(from.addr, from.addr_type);
            match BluezChannel::new(&self.adapter, peer, &socket) {
                Ok(channel) => return Ok(Arc::new(channel)),
                // A peer that has already closed its channel does not affect the listener.
                Err(error) => {
                    tracing::debug!("ble: {peer} closed its channel immediately: {error}")
                }
            }
        }
    }
}

pub(super) struct BluezChannel {
    adapter: String,
    peer: DeviceAddress,
    send_mtu: usize,
    receive_capacity_bytes: usize,
    packets: SduSocket,
}

impl BluezChannel {
    pub(super) async fn connect(
        adapter: &str,
        own: DeviceAddress,
        peer: DeviceAddress,
        psm: Psm,
        options: ChannelOptions,
    ) -> Result<Self, RadioError> {
        let socket = bind(own, None, options).map_err(socket_error("connect", adapter, None))?;
        let socket = connect(socket, peer, psm)
            .await
            .map_err(|error| connect_error(peer, psm, error))?;
        Self::new(adapter, peer, &socket)
    }

    fn new(adapter: &str, peer: DeviceAddress, socket: &SeqPacket) -> Result<Self, RadioError> {
        let send_mtu = socket.send_mtu().map_err(|error| down(peer, error))?;
        let packets = SduSocket::new(socket).map_err(|error| down(peer, error))?;
        let receive_buffer_bytes = packets
            .widen_receive_buffer()
            .map_err(|error| down(peer, error))?;
        Ok(Self {
            adapter: adapter.to_owned(),
            peer,
            send_mtu,
            receive_capacity_bytes: receive_buffer_bytes / BUFFER_BYTES_PER_SDU_BYTE,
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

    fn is_central(&self) -> Option<bool> {
        role::is_central(&self.adapter, self.peer)
    }

    fn receive_capacity_bytes(&self) -> usize {
        self.receive_capacity_bytes
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
                let partial = format!("{sent} of {} bytes of an sdu were sent", sdu.len());
                Err(down(self.peer, std::io::Error::other(partial)))
            }
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => Ok(false),
            Err(error) => Err(down(self.peer, error)),
        }
    }

    async fn writable(&self) {
        self.packets.writable().await;
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
