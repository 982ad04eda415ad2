//! Defines the units that a connection transmits: L2CAP frames, the link-layer packets that carry them, and the
//! commands of L2CAP's signalling channel.
use zenoh_link_ble_radio::address::Psm;

use super::{channel::Piece, message::ChannelId};

/// Size of the length and channel fields at the start of every L2CAP frame.
const L2CAP_HEADER_BYTES: usize = 4;

/// A link-layer packet with data.
#[derive(Debug)]
pub(super) struct Packet {
    pub(super) bytes: usize,
    /// Content that is delivered with this packet; set in the last packet of a frame.
    pub(super) content: Option<PacketContent>,
    /// Channel and number of SDU bytes in this packet, which are reported as sent when it is acknowledged.
    pub(super) completes: Option<(ChannelId, usize)>,
    pub(super) is_delivered: bool,
    pub(super) is_repeated: bool,
}

/// Content of an L2CAP frame, delivered with the frame's last packet.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum PacketContent {
    Signal(Signal),
    Frame {
        channel: ChannelId,
        sdu: Option<Vec<u8>>,
    },
}

/// A command of L2CAP's signalling channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Signal {
    ConnectRequest { channel: ChannelId, psm: Psm },
    ConnectResponse { channel: ChannelId, accepted: bool },
    Disconnect { channel: ChannelId },
    Credits { channel: ChannelId, frames: u32 },
}

/// An L2CAP frame, or the part of it that is not sent yet.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) left_bytes: usize,
    /// Channel of the SDU; `None` for a signalling command.
    channel: Option<ChannelId>,
    /// Bytes of headers at the beginning of the remaining part.
    header_bytes: usize,
    content: PacketContent,
}

impl Frame {
    pub(super) fn of_signal(signal: Signal) -> Self {
        Self {
            left_bytes: L2CAP_HEADER_BYTES + signal.bytes(),
            channel: None,
            header_bytes: 0,
            content: PacketContent::Signal(signal),
        }
    }

    pub(super) fn of_piece(channel: ChannelId, piece: Piece) -> Self {
        Self {
            left_bytes: L2CAP_HEADER_BYTES + piece.bytes,
            channel: Some(channel),
            header_bytes: L2CAP_HEADER_BYTES + piece.bytes - piece.sdu_bytes,
            content: PacketContent::Frame {
                channel,
                sdu: piece.sdu,
            },
        }
    }

    /// Returns the next packet of at most `payload_bytes`, and the remaining part. The frame's content is in its last
    /// packet.
    pub(super) fn cut(self, payload_bytes: usize) -> (Packet, Option<Self>) {
        let bytes = self.left_bytes.min(payload_bytes);
        let headers = self.header_bytes.min(bytes);
        let mut packet = Packet {
            bytes,
            content: None,
            completes: self.channel.map(|channel| (channel, bytes - headers)),
            is_delivered: false,
            is_repeated: false,
        };
        let left_bytes = self.left_bytes - bytes;
        if left_bytes > 0 {
            let header_bytes = self.header_bytes - headers;
            let rest = Self {
                left_bytes,
                header_bytes,
                ..self
            };
            return (packet, Some(rest));
        }
        packet.content = Some(self.content);
        (packet, None)
    }
}

impl Signal {
    /// Returns the size of the command: four bytes of code, identifier and length, then the parameters (Vol 3, Part A,
    /// 4).
    fn bytes(self) -> usize {
        match self {
            Self::ConnectRequest { .. } | Self::ConnectResponse { .. } => 4 + 10,
            Self::Disconnect { .. } | Self::Credits { .. } => 4 + 4,
        }
    }
}
