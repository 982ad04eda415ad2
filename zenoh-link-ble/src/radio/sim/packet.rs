//! Owns what travels on a connection: L2CAP frames, the link-layer packets they are cut into, and the commands of
//! L2CAP's signalling channel.
use super::{channel::Piece, message::ChannelId};
use crate::address::Psm;

/// Every L2CAP frame begins with its length and channel.
const L2CAP_HEADER_BYTES: usize = 4;

/// A link-layer packet with data.
#[derive(Debug)]
pub(super) struct Packet {
    pub(super) bytes: usize,
    /// What arrives with it: the end of a frame.
    pub(super) load: Option<Load>,
    /// Whose bytes are done with once this packet is acknowledged, and how many.
    pub(super) completes: Option<(ChannelId, usize)>,
    pub(super) is_delivered: bool,
    pub(super) is_repeated: bool,
}

/// The end of an L2CAP frame.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Load {
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
    ConnectAnswer { channel: ChannelId, accepted: bool },
    Disconnect { channel: ChannelId },
    Credits { channel: ChannelId, frames: u32 },
}

/// An L2CAP frame, or what is left of it.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) left_bytes: usize,
    /// Whose SDU it is part of.
    channel: Option<ChannelId>,
    /// Bytes of headers at its beginning.
    header_bytes: usize,
    load: Load,
}

impl Frame {
    pub(super) fn of_signal(signal: Signal) -> Self {
        Self {
            left_bytes: L2CAP_HEADER_BYTES + signal.bytes(),
            channel: None,
            header_bytes: 0,
            load: Load::Signal(signal),
        }
    }

    pub(super) fn of_piece(channel: ChannelId, piece: Piece) -> Self {
        Self {
            left_bytes: L2CAP_HEADER_BYTES + piece.bytes,
            channel: Some(channel),
            header_bytes: L2CAP_HEADER_BYTES + piece.bytes - piece.sdu_bytes,
            load: Load::Frame {
                channel,
                sdu: piece.sdu,
            },
        }
    }

    /// Its next packet of at most `payload_bytes`, and the rest; what the frame carries arrives with its last packet.
    pub(super) fn cut(self, payload_bytes: usize) -> (Packet, Option<Self>) {
        let bytes = self.left_bytes.min(payload_bytes);
        let headers = self.header_bytes.min(bytes);
        let mut packet = Packet {
            bytes,
            load: None,
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
        packet.load = Some(self.load);
        (packet, None)
    }
}

impl Signal {
    /// Its size: four bytes of code, identifier and length, then the parameters (Vol 3, Part A, 4).
    fn bytes(self) -> usize {
        match self {
            Self::ConnectRequest { .. } | Self::ConnectAnswer { .. } => 4 + 10,
            Self::Disconnect { .. } | Self::Credits { .. } => 4 + 4,
        }
    }
}
