//! Owns what an adapter tells the air and what the air tells an adapter: the same whether both are in one process or
//! talk over a socket.
use serde::{Deserialize, Serialize};

use crate::{
    address::{DeviceAddress, Psm},
    advertisement::Advertisement,
    radio::AdapterState,
};

/// An L2CAP channel; both its ends have the same number, given by the air.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct ChannelId(pub u64);

/// Something an adapter asked for and may take back: chosen by the adapter, unique while it is pending.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct RequestId(pub u32);

/// What an adapter tells the air.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// Puts an advertisement on the air, until `StopAdvertising`.
    Advertise {
        /// Names it.
        request: RequestId,
        /// The service data.
        advertisement: Advertisement,
        /// The scan response's name.
        name: String,
    },
    /// Takes that advertisement off the air.
    StopAdvertising {
        /// Its name.
        request: RequestId,
    },
    /// Starts or stops hearing advertisements.
    Scan(bool),
    /// Takes channels on a PSM; answered by `Event::Listening`.
    Listen {
        /// Names the question.
        request: RequestId,
        /// The PSM; the air chooses one without.
        psm: Option<Psm>,
        /// The largest SDU taken, in bytes.
        recv_mtu: u16,
    },
    /// Takes no more channels on that PSM.
    Unlisten {
        /// The PSM.
        psm: Psm,
    },
    /// Opens a channel; answered by `Event::Connected` or `Event::ConnectFailed`, however long it takes.
    Connect {
        /// Names the question.
        request: RequestId,
        /// Whom to dial.
        peer: DeviceAddress,
        /// Where it listens.
        psm: Psm,
        /// The largest SDU taken, in bytes.
        recv_mtu: u16,
    },
    /// Gives up on a connect.
    CancelConnect {
        /// Its name.
        request: RequestId,
    },
    /// Queues an SDU; answered by `Event::Sent` when the peer's controller has it all.
    Send {
        /// The channel.
        channel: ChannelId,
        /// The SDU.
        sdu: Vec<u8>,
    },
    /// The oldest unread SDU was read, so that there is room for more.
    Took {
        /// The channel.
        channel: ChannelId,
    },
    /// Closes a channel.
    Close {
        /// The channel.
        channel: ChannelId,
    },
}

/// How much one end of a channel may send.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SendLimits {
    /// The largest SDU the peer takes, in bytes.
    pub sdu_bytes: u16,
    /// How many bytes of SDUs the controller takes ahead of the air: `send` waits while there are more.
    pub ahead_bytes: usize,
}

impl SendLimits {
    /// Whether another SDU may join so many bytes that wait: the socket has room for one, as soon as the controller has all
    /// of the one before.
    pub fn has_room(self, queued_bytes: usize) -> bool {
        queued_bytes <= self.ahead_bytes
    }
}

/// What the air tells an adapter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// The adapter's state changed. Off and missing also end all its advertisements, scans, listeners, pending
    /// connects and channels; nothing more is said of those.
    State(#[serde(with = "state")] AdapterState),
    /// An advertisement was heard.
    Sighting(Heard),
    /// The answer to `Command::Listen`.
    Listening {
        /// The question.
        request: RequestId,
        /// The PSM taken.
        psm: Result<Psm, ListenFailure>,
    },
    /// A peer opened a channel.
    Incoming {
        /// The channel.
        channel: ChannelId,
        /// Where it came in.
        psm: Psm,
        /// Who dialled.
        peer: DeviceAddress,
        /// How much may be sent.
        limits: SendLimits,
    },
    /// A channel asked for is open.
    Connected {
        /// The question.
        request: RequestId,
        /// The channel.
        channel: ChannelId,
        /// How much may be sent.
        limits: SendLimits,
    },
    /// A channel asked for will not be.
    ConnectFailed {
        /// The question.
        request: RequestId,
        /// Why.
        why: ConnectFailure,
    },
    /// The oldest of what is queued on the channel has arrived: so many bytes have room again.
    Sent {
        /// The channel.
        channel: ChannelId,
        /// The SDU's size.
        bytes: usize,
    },
    /// An SDU came in.
    Received {
        /// The channel.
        channel: ChannelId,
        /// The SDU.
        sdu: Vec<u8>,
    },
    /// The channel is down: the peer closed it or the link is lost.
    Closed {
        /// The channel.
        channel: ChannelId,
    },
}

/// One advertisement as it was heard.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Heard {
    /// Who sent it.
    pub device: DeviceAddress,
    /// The service data.
    pub advertisement: Advertisement,
    /// The scan response's name.
    pub name: String,
    /// Signal strength.
    pub rssi_dbm: i16,
}

/// Why a PSM cannot be listened on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ListenFailure {
    /// Another listener of the adapter has it.
    Taken,
    /// All 128 are taken.
    NoneFree,
    /// The adapter is off or missing.
    Unavailable,
}

/// Why there is no channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ConnectFailure {
    /// The peer has no listener there.
    Refused,
    /// The link was lost while the channel was being opened.
    LinkLost,
    /// The adapter is off or missing.
    Unavailable,
}

/// What a misbehaving adapter did. The air drops such a client; others do not notice.
#[derive(Clone, Copy, Debug, thiserror::Error, PartialEq, Eq)]
pub enum Violation {
    /// A PSM outside 0x80 to 0xff.
    #[error("a psm out of range")]
    Psm,
    /// A receive MTU under 23 bytes.
    #[error("a receive mtu under 23 bytes")]
    Mtu,
    /// A name that does not fit the scan response.
    #[error("a name over 29 bytes")]
    Name,
    /// More listeners, advertisements or pending connects than an adapter can have.
    #[error("too many requests at once")]
    TooManyRequests,
    /// A request named like one that is pending.
    #[error("a request that is already pending")]
    DuplicateRequest,
    /// An empty SDU, or one over the peer's MTU.
    #[error("an sdu the channel cannot carry")]
    SduSize,
    /// An SDU for which the send queue had no room.
    #[error("an sdu sent without room for it")]
    NoRoom,
    /// An SDU said to be read that never came.
    #[error("an sdu read that was not there")]
    NothingToTake,
}

/// How an [`AdapterState`] travels: the seam's own type knows nothing of serde.
mod state {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::radio::AdapterState;

    #[derive(Serialize, Deserialize)]
    enum Wire {
        Missing,
        Off,
        On,
    }

    pub fn serialize<S: Serializer>(state: &AdapterState, s: S) -> Result<S::Ok, S::Error> {
        match state {
            AdapterState::Missing => Wire::Missing,
            AdapterState::Off => Wire::Off,
            AdapterState::On => Wire::On,
        }
        .serialize(s)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<AdapterState, D::Error> {
        Ok(match Wire::deserialize(d)? {
            Wire::Missing => AdapterState::Missing,
            Wire::Off => AdapterState::Off,
            Wire::On => AdapterState::On,
        })
    }
}
