//! The kernel's Bluetooth management interface (BlueZ, doc/mgmt-protocol.rst).
//!
//! The kernel decides when a socket is bound whether it may change anything, which requires CAP_NET_ADMIN. A program that
//! has the capability can therefore open the socket with [`open`], and then give the capability up.
use std::{
    io::{self, Read, Write},
    os::fd::AsRawFd,
    sync::atomic::{AtomicU8, Ordering},
    time::Duration,
};

use parking_lot::Mutex;
use socket2::{Domain, Protocol, Socket, Type};
use zenoh_link_ble_radio::address::{AddressType, DeviceAddress};

const BTPROTO_HCI: i32 = 1;
const HCI_DEV_NONE: u16 = 0xffff;
const HCI_CHANNEL_CONTROL: u16 = 3;

const OP_DISCONNECT: u16 = 0x0014;

const EVENT_COMMAND_COMPLETE: u16 = 0x0001;
const EVENT_COMMAND_STATUS: u16 = 0x0002;
const STATUS_PERMISSION_DENIED: u8 = 0x14;

/// How long the kernel may take to answer a command.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
/// Largest event that is read, in bytes. The rest of a larger one is cut off.
const MAX_EVENT_BYTES: usize = 1024;

/// The socket of [`open`], or that of the first command.
static SOCKET: Mutex<Option<Socket>> = Mutex::new(None);

const UNKNOWN: u8 = 0;
const PERMITTED: u8 = 1;
const DENIED: u8 = 2;
static PERMISSION: AtomicU8 = AtomicU8::new(UNKNOWN);

/// Opens the socket that all later commands of the process use.
///
/// # Errors
/// Fails if the kernel has no Bluetooth support.
pub fn open() -> io::Result<()> {
    *SOCKET.lock() = Some(control_socket()?);
    PERMISSION.store(PERMITTED, Ordering::Relaxed);
    Ok(())
}

/// Returns whether the process may send commands, or `None` if it has tried none.
pub fn is_permitted() -> Option<bool> {
    match PERMISSION.load(Ordering::Relaxed) {
        PERMITTED => Some(true),
        DENIED => Some(false),
        _ => None,
    }
}

/// Closes the connection to a peer, and waits until it is closed.
///
/// # Errors
/// Fails if the kernel does not permit it, or if there is no connection.
pub(super) fn disconnect(adapter: &str, peer: DeviceAddress) -> io::Result<()> {
    send(adapter, OP_DISCONNECT, &[encode(peer).to_vec()])
}

/// Encodes an address and its type.
pub(super) fn encode(peer: DeviceAddress) -> [u8; 7] {
    let [a, b, c, d, e, f] = peer.address.0;
    let kind = match peer.kind {
        AddressType::Public => 1,
        AddressType::Random => 2,
    };
    [f, e, d, c, b, a, kind]
}

/// Sends commands with the operation `opcode` for an adapter, each when the kernel has answered the previous one.
///
/// # Errors
/// The first error that the kernel reports; the kind is `PermissionDenied` without the capability.
pub(super) fn send(adapter: &str, opcode: u16, commands: &[Vec<u8>]) -> io::Result<()> {
    let index = adapter.strip_prefix("hci").and_then(|n| n.parse().ok());
    let index: u16 = index.ok_or_else(|| io::Error::other("the adapter has no number"))?;
    let mut kept = SOCKET.lock();
    let socket = match &mut *kept {
        Some(socket) => socket,
        none => none.insert(control_socket()?),
    };
    let sent = commands.iter().try_for_each(|parameters| {
        discard_events(socket)?;
        socket.write_all(&command(index, opcode, parameters))?;
        wait_for_answer(socket, opcode)
    });
    let permission = match &sent {
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => DENIED,
        _ => PERMITTED,
    };
    PERMISSION.store(permission, Ordering::Relaxed);
    sent
}

fn control_socket() -> io::Result<Socket> {
    let socket = Socket::new(
        Domain::from(libc::AF_BLUETOOTH),
        Type::RAW,
        Some(Protocol::from(BTPROTO_HCI)),
    )?;
    socket.set_read_timeout(Some(ANSWER_TIMEOUT))?;
    // `struct sockaddr_hci` of the kernel (include/net/bluetooth/hci_sock.h).
    let address = [libc::AF_BLUETOOTH as u16, HCI_DEV_NONE, HCI_CHANNEL_CONTROL];
    // SAFETY: `address` has the layout and the size of a sockaddr_hci and outlives the call.
    let result = unsafe {
        libc::bind(
            socket.as_raw_fd(),
            address.as_ptr().cast(),
            size_of_val(&address) as libc::socklen_t,
        )
    };
    if result == 0 {
        Ok(socket)
    } else {
        Err(io::Error::last_os_error())
    }
}

fn command(index: u16, opcode: u16, parameters: &[u8]) -> Vec<u8> {
    let size = u16::try_from(parameters.len()).unwrap_or(u16::MAX);
    let header = [opcode, index, size];
    let mut command: Vec<u8> = header.into_iter().flat_map(u16::to_le_bytes).collect();
    command.extend(parameters);
    command
}

/// Empties the socket: the kernel reports what other programs do to each socket, and drops its answer if there is no room.
fn discard_events(socket: &mut Socket) -> io::Result<()> {
    let mut event = [0; MAX_EVENT_BYTES];
    socket.set_nonblocking(true)?;
    while socket.read(&mut event).is_ok() {}
    socket.set_nonblocking(false)
}

/// Reads events of the kernel until one answers the command.
fn wait_for_answer(socket: &mut Socket, opcode: u16) -> io::Result<()> {
    let mut event = [0; MAX_EVENT_BYTES];
    loop {
        let size = socket.read(&mut event)?;
        let event = event.get(..size).unwrap_or_default();
        return match answer_status(event, opcode) {
            None => continue,
            Some(0) => Ok(()),
            Some(STATUS_PERMISSION_DENIED) => Err(io::ErrorKind::PermissionDenied.into()),
            Some(other) => Err(io::Error::other(format!(
                "the kernel answered with status {other:#04x}"
            ))),
        };
    }
}

/// Returns the status if the event answers the command.
fn answer_status(event: &[u8], asked: u16) -> Option<u8> {
    let (header, parameters) = event.split_at_checked(6)?;
    let kind = u16::from_le_bytes(*header.first_chunk()?);
    let (opcode, rest) = parameters.split_first_chunk::<2>()?;
    let is_answer = matches!(kind, EVENT_COMMAND_COMPLETE | EVENT_COMMAND_STATUS)
        && u16::from_le_bytes(*opcode) == asked;
    rest.first().copied().filter(|_| is_answer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenoh_link_ble_radio::address::Address;

    const OPCODE: u16 = 0x0035;

    #[test]
    fn encodes_addresses_in_reverse_order() {
        let peer = |kind| DeviceAddress {
            address: Address([0xdc, 0xa6, 0x32, 1, 2, 3]),
            kind,
        };
        let public = [3, 2, 1, 0x32, 0xa6, 0xdc, 1];
        assert_eq!(encode(peer(AddressType::Public)), public);
        assert_eq!(encode(peer(AddressType::Random))[6], 2);
    }

    #[test]
    fn encodes_the_header_of_a_command() {
        let expected = [0x35, 0, 1, 0, 2, 0, 7, 8];
        assert_eq!(command(1, OPCODE, &[7, 8]), expected);
    }

    #[test]
    fn recognises_the_answer_among_other_events() {
        let complete = [1, 0, 0, 0, 3, 0, 0x35, 0, 0];
        assert_eq!(answer_status(&complete, OPCODE), Some(0));
        let denied = [2, 0, 0, 0, 3, 0, 0x35, 0, 0x14];
        assert_eq!(answer_status(&denied, OPCODE), Some(0x14));
        let other_command = [1, 0, 0, 0, 3, 0, 0x36, 0, 0];
        let other_event = [6, 0, 0, 0, 3, 0, 0x35, 0, 0];
        for event in [&other_command[..], &other_event, &complete[..8], &[]] {
            assert_eq!(answer_status(event, OPCODE), None, "{event:?}");
        }
    }
}
