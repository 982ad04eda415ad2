//! Sets the connection interval for single peers through the kernel's management interface: `Load Connection Parameters`
//! (BlueZ, doc/mgmt-protocol.rst), which requires CAP_NET_ADMIN.
//!
//! The kernel uses the parameters for the next connection to the peer of which this adapter is the central. Since Linux
//! 6.11, a command with one peer that the kernel knows already also updates the existing connection. A command with
//! several peers, and before 6.11 every command, replaces the parameters of all others. Therefore [`PeerIntervals::set`]
//! loads all peers, then the changed one, then all peers again.
use std::{
    io::{self, Read, Write},
    os::fd::AsRawFd,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use parking_lot::Mutex;
use socket2::{Domain, Protocol, Socket, Type};

use crate::{
    address::{AddressType, DeviceAddress},
    interval::ConnectionInterval,
};

const BTPROTO_HCI: i32 = 1;
const HCI_DEV_NONE: u16 = 0xffff;
const HCI_CHANNEL_CONTROL: u16 = 3;

const OP_LOAD_CONNECTION_PARAMETERS: u16 = 0x0035;
const EVENT_COMMAND_COMPLETE: u16 = 0x0001;
const EVENT_COMMAND_STATUS: u16 = 0x0002;

/// Supervision timeout in units of 10 ms, as in `config/bluetooth.conf`.
const SUPERVISION_TIMEOUT: u16 = 200;
/// Largest number of peers whose intervals are kept: the kernel's other parameters stay few.
const MAX_PEERS: usize = 32;
/// How long the kernel may take to answer a command.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// The intervals that were set for peers of one adapter.
#[derive(Default)]
pub(super) struct PeerIntervals {
    chosen: Mutex<Vec<(DeviceAddress, ConnectionInterval)>>,
    has_explained: AtomicBool,
}

impl PeerIntervals {
    /// Sets the interval for a peer. Returns whether the kernel permits it. If it does not, logs once what the user can do.
    pub(super) async fn set(
        &self,
        adapter: &str,
        peer: DeviceAddress,
        interval: ConnectionInterval,
    ) -> bool {
        let all = {
            let mut chosen = self.chosen.lock();
            chosen.retain(|(device, _)| *device != peer);
            if chosen.len() >= MAX_PEERS {
                chosen.remove(0);
            }
            chosen.push((peer, interval));
            chosen.clone()
        };
        let name = adapter.to_owned();
        let loaded = tokio::task::spawn_blocking(move || load(&name, &all)).await;
        let error = match loaded {
            Ok(Ok(())) => return true,
            Ok(Err(error)) => error,
            Err(error) => io::Error::other(error),
        };
        if !self.has_explained.swap(true, Ordering::Relaxed) {
            tracing::info!(
                "ble: {adapter}: all links get the same connection interval ({error}). A robot with links in both \
                 directions may lose one now and then; it is dialled again. To let the router choose intervals, give it \
                 CAP_NET_ADMIN: see the page \"Many robots in one hall\" of RECT's documentation"
            );
        }
        false
    }
}

/// Loads the intervals of all peers. The last one is the one that has changed.
fn load(adapter: &str, all: &[(DeviceAddress, ConnectionInterval)]) -> io::Result<()> {
    let index = adapter.strip_prefix("hci").and_then(|n| n.parse().ok());
    let index: u16 = index.ok_or_else(|| io::Error::other("the adapter has no number"))?;
    let mut socket = control_socket()?;
    let changed = all.last().map(std::slice::from_ref).unwrap_or_default();
    for peers in [all, changed, all] {
        socket.write_all(&command(index, peers))?;
        wait_for_answer(&mut socket)?;
    }
    Ok(())
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

/// Encodes the command with the parameters of these peers.
fn command(index: u16, peers: &[(DeviceAddress, ConnectionInterval)]) -> Vec<u8> {
    let mut parameters = u16::try_from(peers.len())
        .unwrap_or(0)
        .to_le_bytes()
        .to_vec();
    for (peer, interval) in peers {
        parameters.extend(peer.address.0.iter().rev());
        parameters.push(match peer.kind {
            AddressType::Public => 1,
            AddressType::Random => 2,
        });
        // Minimum and maximum interval, latency, supervision timeout.
        for value in [interval.units(), interval.units(), 0, SUPERVISION_TIMEOUT] {
            parameters.extend(value.to_le_bytes());
        }
    }
    let size = u16::try_from(parameters.len()).unwrap_or(u16::MAX);
    let header = [OP_LOAD_CONNECTION_PARAMETERS, index, size];
    let mut command: Vec<u8> = header.into_iter().flat_map(u16::to_le_bytes).collect();
    command.extend(parameters);
    command
}

/// Reads events of the kernel until one answers the command.
fn wait_for_answer(socket: &mut Socket) -> io::Result<()> {
    let mut event = [0; 1024];
    loop {
        let size = socket.read(&mut event)?;
        if let Some(status) = answer_status(event.get(..size).unwrap_or_default()) {
            return match status {
                0 => Ok(()),
                0x14 => Err(io::ErrorKind::PermissionDenied.into()),
                other => Err(io::Error::other(format!(
                    "the kernel answered with status {other:#04x}"
                ))),
            };
        }
    }
}

/// Returns the status if the event answers the command.
fn answer_status(event: &[u8]) -> Option<u8> {
    let (header, parameters) = event.split_at_checked(6)?;
    let kind = u16::from_le_bytes(*header.first_chunk()?);
    let (opcode, rest) = parameters.split_first_chunk::<2>()?;
    let is_answer = matches!(kind, EVENT_COMMAND_COMPLETE | EVENT_COMMAND_STATUS)
        && u16::from_le_bytes(*opcode) == OP_LOAD_CONNECTION_PARAMETERS;
    rest.first().copied().filter(|_| is_answer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::address::Address;

    #[test]
    fn encodes_the_command_of_the_management_interface() {
        let peer = DeviceAddress {
            address: Address([0xdc, 0xa6, 0x32, 1, 2, 3]),
            kind: AddressType::Public,
        };
        let interval = ConnectionInterval::from_units(12).expect("valid");
        let expected = [
            0x35, 0, 1, 0, 17, 0, // command, adapter, size of the parameters
            1, 0, // number of peers
            3, 2, 1, 0x32, 0xa6, 0xdc, 1, // address and its type
            12, 0, 12, 0, 0, 0, 200, 0,
        ];
        assert_eq!(command(1, &[(peer, interval)]), expected);
    }

    #[test]
    fn recognises_the_answer_among_other_events() {
        let complete = [1, 0, 0, 0, 3, 0, 0x35, 0, 0];
        assert_eq!(answer_status(&complete), Some(0));
        let denied = [2, 0, 0, 0, 3, 0, 0x35, 0, 0x14];
        assert_eq!(answer_status(&denied), Some(0x14));
        let other_command = [1, 0, 0, 0, 3, 0, 0x36, 0, 0];
        let other_event = [6, 0, 0, 0, 3, 0, 0x35, 0, 0];
        for event in [&other_command[..], &other_event, &complete[..8], &[]] {
            assert_eq!(answer_status(event), None, "{event:?}");
        }
    }
}
