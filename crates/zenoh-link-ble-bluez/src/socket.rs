//! Opens L2CAP sockets, and works around pitfalls of the kernel and of bluer.
//!
//! The `connect` method of bluer registers the socket before it connects. It takes the readiness of the unconnected
//! socket for success and returns while the channel is still being established, and the "hung up" flag is never
//! cleared. Here, a socket is registered while it is connecting, and registered with bluer again once it is connected.
use std::{
    io,
    os::fd::{AsRawFd, FromRawFd, IntoRawFd},
};

use bluer::l2cap::{FlowControl, SeqPacket, Socket, SocketAddr};
use tokio::io::{unix::AsyncFd, Interest};
use zenoh_link_ble_radio::{
    address::{AddressType, DeviceAddress, Psm},
    ChannelOptions, Security,
};

use super::sdu_socket::{is_hung_up, is_writable};

/// `struct sockaddr_l2` of the kernel (include/net/bluetooth/l2cap.h).
#[repr(C)]
struct SockaddrL2 {
    family: libc::sa_family_t,
    psm_le: u16,
    address_reversed: [u8; 6],
    cid_le: u16,
    address_kind: u8,
}

const BDADDR_LE_PUBLIC: u8 = 1;
const BDADDR_LE_RANDOM: u8 = 2;

/// Returns a socket that is bound to the local adapter. The LE address must be bound first: the other options depend on
/// it.
pub(super) fn bind(
    own: DeviceAddress,
    psm: Option<Psm>,
    options: ChannelOptions,
) -> io::Result<Socket<SeqPacket>> {
    let socket = Socket::<SeqPacket>::new_seq_packet()?;
    let psm = psm.map_or(0, Psm::number);
    socket.bind(SocketAddr::new(
        bluer::Address(own.address.0),
        bluer_kind(own.kind),
        psm,
    ))?;
    // Old kernels have no such option for LE sockets and always use the right mode.
    let _ = socket.set_flow_control(FlowControl::Le);
    socket.set_recv_mtu(options.recv_mtu)?;
    let level = match options.security {
        Security::Low => bluer::l2cap::SecurityLevel::Low,
        Security::Medium => bluer::l2cap::SecurityLevel::Medium,
        Security::High => bluer::l2cap::SecurityLevel::High,
    };
    socket.set_security(bluer::l2cap::Security { level, key_size: 0 })?;
    Ok(socket)
}

/// Connects the socket. Dropping the future closes the socket, which cancels the attempt in the kernel.
pub(super) async fn connect(
    socket: Socket<SeqPacket>,
    peer: DeviceAddress,
    psm: Psm,
) -> io::Result<SeqPacket> {
    // SAFETY: `into_raw_fd` releases the descriptor, which is open and has no other owner.
    let socket = unsafe { socket2::Socket::from_raw_fd(socket.into_raw_fd()) };
    start_connect(&socket, peer, psm)?;
    // SAFETY: `socket` owns its descriptor and keeps the same one until it is taken back below.
    let connecting = unsafe { AsyncFd::register_with_interest(socket, Interest::WRITABLE) }?;
    let connected = |socket: &socket2::Socket| match socket.take_error()? {
        Some(error) => Err(error),
        None if is_hung_up(socket) => Err(io::ErrorKind::NotConnected.into()),
        None if is_writable(socket) => Ok(()),
        None => Err(io::ErrorKind::WouldBlock.into()),
    };
    connecting.async_io(Interest::WRITABLE, connected).await?;
    let socket = connecting.into_inner();
    // SAFETY: the descriptor is released here and owned only by the new `SeqPacket`.
    unsafe { SeqPacket::from_raw_fd(socket.into_raw_fd()) }
}

fn start_connect(socket: &socket2::Socket, peer: DeviceAddress, psm: Psm) -> io::Result<()> {
    let mut address_reversed = peer.address.0;
    address_reversed.reverse();
    let to = SockaddrL2 {
        family: libc::AF_BLUETOOTH as libc::sa_family_t,
        psm_le: psm.number().to_le(),
        address_reversed,
        cid_le: 0,
        address_kind: match peer.kind {
            AddressType::Public => BDADDR_LE_PUBLIC,
            AddressType::Random => BDADDR_LE_RANDOM,
        },
    };
    // SAFETY: `to` is a valid sockaddr_l2 of the given size and outlives the call.
    let result = unsafe {
        libc::connect(
            socket.as_raw_fd(),
            std::ptr::from_ref(&to).cast(),
            size_of::<SockaddrL2>() as libc::socklen_t,
        )
    };
    if result == 0 {
        return Ok(());
    }
    let error = io::Error::last_os_error();
    match error.raw_os_error() {
        Some(libc::EINPROGRESS | libc::EAGAIN) => Ok(()),
        _ => Err(error),
    }
}

pub(super) fn bluer_kind(kind: AddressType) -> bluer::AddressType {
    match kind {
        AddressType::Public => bluer::AddressType::LePublic,
        AddressType::Random => bluer::AddressType::LeRandom,
    }
}
