//! Parses and builds HCI packets in H4 framing, as far as the relay needs them. All received data is checked for its
//! length.

use std::time::Duration;

use thiserror::Error;

/// H4 packet types.
pub const COMMAND: u8 = 0x01;
pub const ACL: u8 = 0x02;
pub const EVENT: u8 = 0x04;
/// Packet type of vhci: creates a device and reports its index.
pub const VENDOR: u8 = 0xff;

/// Size of an ACL packet's H4 type and header.
pub const ACL_HEADER_BYTES: usize = 5;
/// Maximum size of a packet of an emulated controller.
const MAX_PACKET_BYTES: usize = 2048;

const HCI_RESET: u16 = 0x0c03;
const DISCONNECT: u16 = 0x0406;
const READ_BD_ADDR: u16 = 0x1009;
const LE_SET_RANDOM_ADDRESS: u16 = 0x2005;
const LE_SET_ADVERTISING_PARAMETERS: u16 = 0x2006;
const LE_CONNECTION_UPDATE: u16 = 0x2013;
const LE_READ_BUFFER_SIZE: u16 = 0x2002;
const LE_READ_BUFFER_SIZE_V2: u16 = 0x2060;

const DISCONNECTION_COMPLETE: u8 = 0x05;
const COMMAND_COMPLETE: u8 = 0x0e;
const COMMAND_STATUS: u8 = 0x0f;
const NUMBER_OF_COMPLETED_PACKETS: u8 = 0x13;
const LE_META: u8 = 0x3e;

/// Reason of a disconnection: the supervision timeout expired.
pub const CONNECTION_TIMEOUT: u8 = 0x08;

/// HCI Reset, and its response.
pub const RESET: [u8; 4] = [COMMAND, 0x03, 0x0c, 0];
pub const RESET_COMPLETE: [u8; 7] = [EVENT, COMMAND_COMPLETE, 4, 1, 0x03, 0x0c, 0];

pub type Address = [u8; 6];
pub type Handle = u16;

/// The received data is not HCI.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum HciError {
    #[error("unknown packet type {0:#04x}")]
    Type(u8),
    #[error("a packet of {0} bytes is larger than any controller sends")]
    TooLong(usize),
}

/// Returns the length of the packet at the start of `bytes`, once its header is complete.
pub fn packet_bytes(bytes: &[u8]) -> Result<Option<usize>, HciError> {
    let total = match *bytes {
        [] => return Ok(None),
        [EVENT, _, n, ..] => 3 + usize::from(n),
        [COMMAND, _, _, n, ..] => 4 + usize::from(n),
        [ACL, _, _, low, high, ..] => {
            ACL_HEADER_BYTES + usize::from(u16::from_le_bytes([low, high]))
        }
        [EVENT | COMMAND | ACL, ..] => return Ok(None),
        [other, ..] => return Err(HciError::Type(other)),
    };
    if total > MAX_PACKET_BYTES {
        return Err(HciError::TooLong(total));
    }
    Ok(Some(total))
}

/// Commands of the kernel that are relevant to the relay.
#[derive(Debug, PartialEq, Eq)]
pub enum HostCommand {
    /// Resets the controller.
    Reset,
    Disconnect,
    /// Changes the connection interval of a link, in units of 1.25 ms.
    UpdateConnection {
        handle: Handle,
        interval: u16,
    },
    SetRandomAddress(Address),
    /// Maximum time between two advertising events.
    SetAdvertisingInterval(Duration),
    Other,
}

pub fn host_command(packet: &[u8]) -> HostCommand {
    let [COMMAND, low, high, _, parameters @ ..] = packet else {
        return HostCommand::Other;
    };
    match (u16::from_le_bytes([*low, *high]), parameters) {
        (HCI_RESET, _) => HostCommand::Reset,
        (DISCONNECT, _) => HostCommand::Disconnect,
        // Handle, minimum and maximum interval.
        (LE_CONNECTION_UPDATE, [handle_low, handle_high, _, _, low, high, ..]) => {
            HostCommand::UpdateConnection {
                handle: u16::from_le_bytes([*handle_low, *handle_high]),
                interval: u16::from_le_bytes([*low, *high]),
            }
        }
        (LE_SET_RANDOM_ADDRESS, [a, b, c, d, e, f]) => {
            HostCommand::SetRandomAddress([*a, *b, *c, *d, *e, *f])
        }
        // In units of 0.625 ms (Core Specification, Vol 4, Part E, 7.8.5).
        (LE_SET_ADVERTISING_PARAMETERS, [_, _, low, high, ..]) => {
            let units = u16::from_le_bytes([*low, *high]);
            HostCommand::SetAdvertisingInterval(Duration::from_micros(625) * u32::from(units))
        }
        _ => HostCommand::Other,
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    Central,
    Peripheral,
}

/// Events of the emulated controller that are relevant to the relay.
#[derive(Debug, PartialEq, Eq)]
pub enum ControllerEvent {
    OwnAddress(Address),
    /// Response to either version of LE Read Buffer Size; the values are at the same positions in both.
    BufferSize,
    DisconnectStatus,
    UpdateConnectionStatus,
    /// There is a link, with this connection interval in units of 1.25 ms.
    Connected {
        handle: Handle,
        role: Role,
        peer: Address,
        interval: u16,
    },
    Disconnected {
        handle: Handle,
    },
    /// An advertisement was received. Contains the address of the first report (btvirt sends one per event).
    AdvertisingReport {
        from: Address,
    },
    Other,
}

pub fn controller_event(packet: &[u8]) -> ControllerEvent {
    let [EVENT, code, _, parameters @ ..] = packet else {
        return ControllerEvent::Other;
    };
    match (*code, parameters) {
        (COMMAND_COMPLETE, [_, low, high, 0, rest @ ..]) => {
            match (u16::from_le_bytes([*low, *high]), rest) {
                (READ_BD_ADDR, [a, b, c, d, e, f]) => {
                    ControllerEvent::OwnAddress([*a, *b, *c, *d, *e, *f])
                }
                (LE_READ_BUFFER_SIZE | LE_READ_BUFFER_SIZE_V2, [_, _, _, ..]) => {
                    ControllerEvent::BufferSize
                }
                _ => ControllerEvent::Other,
            }
        }
        (COMMAND_STATUS, [_, _, low, high]) if u16::from_le_bytes([*low, *high]) == DISCONNECT => {
            ControllerEvent::DisconnectStatus
        }
        (COMMAND_STATUS, [0, _, low, high])
            if u16::from_le_bytes([*low, *high]) == LE_CONNECTION_UPDATE =>
        {
            ControllerEvent::UpdateConnectionStatus
        }
        (DISCONNECTION_COMPLETE, [0, low, high, _]) => ControllerEvent::Disconnected {
            handle: u16::from_le_bytes([*low, *high]),
        },
        // LE Connection Complete and its enhanced form start with the same fields: status, handle, role, peer's address
        // type, address. In the enhanced form, two more addresses precede the interval.
        (LE_META, [form @ (0x01 | 0x0a), 0, low, high, role, _, a, b, c, d, e, f, rest @ ..]) => {
            let more_addresses = if *form == 0x0a { 12 } else { 0 };
            let Some([interval_low, interval_high, ..]) = rest.get(more_addresses..) else {
                return ControllerEvent::Other;
            };
            ControllerEvent::Connected {
                handle: u16::from_le_bytes([*low, *high]),
                role: if *role == 0 {
                    Role::Central
                } else {
                    Role::Peripheral
                },
                peer: [*a, *b, *c, *d, *e, *f],
                interval: u16::from_le_bytes([*interval_low, *interval_high]),
            }
        }
        (LE_META, [0x02, _, _, _, a, b, c, d, e, f, ..]) => ControllerEvent::AdvertisingReport {
            from: [*a, *b, *c, *d, *e, *f],
        },
        // Extended report: subevent, count, event type (2), address type, address.
        (LE_META, [0x0d, _, _, _, _, a, b, c, d, e, f, ..]) => ControllerEvent::AdvertisingReport {
            from: [*a, *b, *c, *d, *e, *f],
        },
        _ => ControllerEvent::Other,
    }
}

/// Replaces the values in the response to LE Read Buffer Size; 0 keeps a value.
pub fn set_buffer_size(packet: &mut [u8], acl_bytes: u16, buffers: u8) {
    let Some([low, high, count, ..]) = packet.get_mut(7..) else {
        return;
    };
    if acl_bytes > 0 {
        [*low, *high] = acl_bytes.to_le_bytes();
    }
    if buffers > 0 {
        *count = buffers;
    }
}

/// Replaces the handle in LE Connection Complete.
pub fn set_connected_handle(packet: &mut [u8], handle: Handle) {
    if let Some(field) = packet.get_mut(5..7) {
        field.copy_from_slice(&handle.to_le_bytes());
    }
}

/// LE Connection Update Complete, with the supervision timeout that the robots use, 2 s.
pub fn update_complete(handle: Handle, interval: u16) -> Vec<u8> {
    let [low, high] = handle.to_le_bytes();
    let [interval_low, interval_high] = interval.to_le_bytes();
    let head = [EVENT, LE_META, 10, 0x03, 0, low, high];
    [&head[..], &[interval_low, interval_high, 0, 0, 200, 0]].concat()
}

pub fn disconnection_complete(handle: Handle, reason: u8) -> Vec<u8> {
    let [low, high] = handle.to_le_bytes();
    vec![EVENT, DISCONNECTION_COMPLETE, 4, 0, low, high, reason]
}

pub fn acl_handle(packet: &[u8]) -> Option<Handle> {
    match packet {
        [ACL, low, high, _, _, ..] => Some(u16::from_le_bytes([*low, *high]) & 0x0fff),
        _ => None,
    }
}

/// Returns the packet as the peer's controller delivers it: with the peer's handle, and with "first, not flushable",
/// which only a host may send, replaced by "first".
pub fn acl_for_peer(mut packet: Vec<u8>, handle: Handle) -> Vec<u8> {
    if let [ACL, low, high, ..] = packet.as_mut_slice() {
        let continuing = u16::from_le_bytes([*low, *high]) & 0x3000 == 0x1000;
        [*low, *high] = (handle | if continuing { 0x1000 } else { 0x2000 }).to_le_bytes();
    }
    packet
}

pub fn one_packet_completed(handle: Handle) -> Vec<u8> {
    let [low, high] = handle.to_le_bytes();
    vec![EVENT, NUMBER_OF_COMPLETED_PACKETS, 5, 1, low, high, 1, 0]
}

pub fn disconnect(handle: Handle, reason: u8) -> Vec<u8> {
    let [low, high] = handle.to_le_bytes();
    let [op_low, op_high] = DISCONNECT.to_le_bytes();
    vec![COMMAND, op_low, op_high, 3, low, high, reason]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn determines_the_packet_length_from_the_header() {
        assert_eq!(packet_bytes(&[]), Ok(None));
        assert_eq!(packet_bytes(&[EVENT, 0x0e]), Ok(None));
        assert_eq!(packet_bytes(&[EVENT, 0x0e, 4]), Ok(Some(7)));
        assert_eq!(packet_bytes(&[ACL, 42, 0, 251, 0]), Ok(Some(256)));
    }

    #[test]
    fn rejects_invalid_packets() {
        assert_eq!(packet_bytes(&[9]), Err(HciError::Type(9)));
        assert_eq!(
            packet_bytes(&[ACL, 0, 0, 0xff, 0xff]),
            Err(HciError::TooLong(65540))
        );
    }

    #[test]
    fn ignores_truncated_events() {
        let connected = [
            EVENT, LE_META, 19, 1, 0, 42, 0, 0, 0, 1, 2, 3, 4, 5, 6, 12, 0, 0, 0, 0, 0, 0,
        ];
        for n in 0..17 {
            assert_eq!(
                controller_event(&connected[..n]),
                ControllerEvent::Other,
                "{n} bytes"
            );
        }
        assert_eq!(
            controller_event(&connected),
            ControllerEvent::Connected {
                handle: 42,
                role: Role::Central,
                peer: [1, 2, 3, 4, 5, 6],
                interval: 12,
            }
        );
    }

    #[test]
    fn replaces_the_buffer_size_in_place() {
        let mut packet = [EVENT, COMMAND_COMPLETE, 7, 1, 0x02, 0x20, 0, 192, 0, 1];
        assert_eq!(controller_event(&packet), ControllerEvent::BufferSize);
        set_buffer_size(&mut packet, 251, 0);
        assert_eq!(&packet[7..], &[251, 0, 1]);
        set_buffer_size(&mut packet, 0, 8);
        assert_eq!(&packet[7..], &[251, 0, 8]);
    }

    #[test]
    fn converts_the_first_packet_of_a_host_for_the_peer() {
        assert_eq!(
            acl_for_peer(vec![ACL, 42, 0x00, 1, 0, 7], 43),
            [ACL, 43, 0x20, 1, 0, 7]
        );
        assert_eq!(
            acl_for_peer(vec![ACL, 42, 0x20, 1, 0, 7], 43),
            [ACL, 43, 0x20, 1, 0, 7]
        );
        assert_eq!(
            acl_for_peer(vec![ACL, 42, 0x10, 1, 0, 7], 43),
            [ACL, 43, 0x10, 1, 0, 7]
        );
    }
}
