//! Determines whether an adapter is the central of a connection, from the kernel's list of connections (`HCIGETCONNLIST`),
//! which needs no privilege.
use std::os::fd::AsRawFd;

use socket2::{Domain, Protocol, Socket, Type};
use zenoh_link_ble_radio::address::DeviceAddress;

const BTPROTO_HCI: i32 = 1;
/// `_IOR('H', 212, int)`.
const HCIGETCONNLIST: libc::c_ulong = 0x8004_48d4;
const LE_LINK: u8 = 0x80;
const HCI_LM_MASTER: u32 = 0x0001;
/// More connections than any controller has.
const MAX_CONNECTIONS: usize = 64;

/// `struct hci_conn_info` of the kernel (include/net/bluetooth/hci_sock.h).
#[repr(C)]
#[derive(Clone, Copy, Default)]
struct ConnectionInfo {
    handle: u16,
    address_reversed: [u8; 6],
    kind: u8,
    is_outgoing: u8,
    state: u16,
    link_mode: u32,
}

/// `struct hci_conn_list_req` of the kernel.
#[repr(C)]
struct ConnectionList {
    adapter: u16,
    count: u16,
    connections: [ConnectionInfo; MAX_CONNECTIONS],
}

/// Returns whether the adapter is the central of its connection to the peer, or `None` if the kernel does not list it.
pub(super) fn is_central(adapter: &str, peer: DeviceAddress) -> Option<bool> {
    let index = adapter.strip_prefix("hci")?.parse().ok()?;
    let socket = Socket::new(
        Domain::from(libc::AF_BLUETOOTH),
        Type::RAW,
        Some(Protocol::from(BTPROTO_HCI)),
    );
    let mut list = ConnectionList {
        adapter: index,
        count: MAX_CONNECTIONS as u16,
        connections: [ConnectionInfo::default(); MAX_CONNECTIONS],
    };
    // SAFETY: `list` has the layout of a hci_conn_list_req, `count` is the number of its elements, and it outlives the call.
    let result = unsafe {
        libc::ioctl(
            socket.ok()?.as_raw_fd(),
            HCIGETCONNLIST as _,
            std::ptr::from_mut(&mut list),
        )
    };
    if result != 0 {
        return None;
    }
    let count = usize::from(list.count).min(MAX_CONNECTIONS);
    is_central_in(&list.connections[..count], peer)
}

fn is_central_in(connections: &[ConnectionInfo], peer: DeviceAddress) -> Option<bool> {
    let mut address_reversed = peer.address.0;
    address_reversed.reverse();
    let connection = connections
        .iter()
        .find(|c| c.kind == LE_LINK && c.address_reversed == address_reversed)?;
    Some(connection.link_mode & HCI_LM_MASTER != 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenoh_link_ble_radio::address::{Address, AddressType};

    #[test]
    fn structures_have_the_size_of_the_kernels() {
        assert_eq!(size_of::<ConnectionInfo>(), 16);
        assert_eq!(size_of::<ConnectionList>(), 4 + 16 * MAX_CONNECTIONS);
    }

    #[test]
    fn finds_the_connection_of_the_peer() {
        let peer = |n| DeviceAddress {
            address: Address([0xdc, 0xa6, 0x32, 1, 2, n]),
            kind: AddressType::Public,
        };
        let info = |n, kind, link_mode| ConnectionInfo {
            address_reversed: [n, 2, 1, 0x32, 0xa6, 0xdc],
            kind,
            link_mode,
            ..ConnectionInfo::default()
        };
        let connections = [info(1, 1, 0), info(1, LE_LINK, 5), info(2, LE_LINK, 4)];
        assert_eq!(is_central_in(&connections, peer(1)), Some(true));
        assert_eq!(is_central_in(&connections, peer(2)), Some(false));
        assert_eq!(is_central_in(&connections, peer(3)), None);
    }
}
