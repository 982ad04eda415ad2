//! Defines the commands of adapters and the events of the air. They are the same within one process and over a socket.
use serde::{Deserialize, Serialize};
use zenoh_link_ble_radio::{
    address::{DeviceAddress, Psm},
    advertisement::Advertisement,
    AdapterState,
};

/// Identifies an L2CAP channel. The air assigns the id, which is the same at both ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct ChannelId(pub u64);

/// Identifies a pending request of an adapter. The adapter chooses the id, which is unique while the request is
/// pending.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct RequestId(pub u32);

/// Commands of an adapter to the air.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// Starts an advertisement, which continues until `StopAdvertising`.
    Advertise {
        /// Id of the advertisement.
        request: RequestId,
        /// Service data of the advertisement.
        advertisement: Advertisement,
        /// Name in the scan response.
        name: String,
    },
    /// Stops an advertisement.
    StopAdvertising {
        /// Id of the request.
        request: RequestId,
    },
    /// Starts or stops receiving advertisements.
    Scan(bool),
    /// Accepts channels on a PSM. The response is `Event::Listening`.
    Listen {
        /// Id of the request.
        request: RequestId,
        /// PSM to listen on; `None` lets the air choose one.
        psm: Option<Psm>,
        /// Largest SDU that this end receives, in bytes.
        recv_mtu: u16,
    },
    /// Stops listening on a PSM.
    Unlisten {
        /// PSM of the listener.
        psm: Psm,
    },
    /// Opens a channel. The response is `Event::Connected` or `Event::ConnectFailed`, without a time limit.
    Connect {
        /// Id of the request.
        request: RequestId,
        /// Address of the peer.
        peer: DeviceAddress,
        /// PSM on which the peer listens.
        psm: Psm,
        /// Largest SDU that this end receives, in bytes.
        recv_mtu: u16,
    },
    /// Cancels a connect.
    CancelConnect {
        /// Id of the request.
        request: RequestId,
    },
    /// Queues an SDU. One or more `Event::Sent` report the bytes that the peer's controller has received.
    Send {
        /// Channel.
        channel: ChannelId,
        /// Content of the SDU.
        sdu: Vec<u8>,
    },
    /// Reports that the oldest unread SDU was read, which makes room for more.
    SduRead {
        /// Channel.
        channel: ChannelId,
    },
    /// Sets the interval of connections to a peer of which the adapter is the central: of the next one, and of an
    /// existing one if the air's options permit it.
    SetInterval {
        /// Address of the peer.
        peer: DeviceAddress,
        /// Interval in units of 1.25 ms.
        units: u16,
    },
    /// Closes a channel. Its connection stays open.
    Close {
        /// Channel.
        channel: ChannelId,
    },
    /// Closes the connection to a peer, with all channels on it.
    Disconnect {
        /// Address of the peer.
        peer: DeviceAddress,
    },
}

/// Limits for sending at one end of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SendLimits {
    /// Largest SDU that the peer receives, in bytes.
    pub sdu_bytes: u16,
    /// Number of queued bytes that the controller accepts ahead of transmission. `send` waits while more bytes are
    /// queued.
    pub ahead_bytes: usize,
}

impl SendLimits {
    /// Returns whether another SDU may be queued behind `queued_bytes`. The socket accepts one more SDU as soon as the
    /// controller has the whole previous one.
    pub fn has_room(self, queued_bytes: usize) -> bool {
        queued_bytes <= self.ahead_bytes
    }
}

/// Events of the air for an adapter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// The adapter's state changed. `Off` and `Missing` also end all its advertisements, scans, listeners, pending
    /// connects and channels, without further events for them.
    State(#[serde(with = "state")] AdapterState),
    /// An advertisement was received.
    AdvertisementReceived(ReceivedAdvertisement),
    /// Response to `Command::Listen`.
    Listening {
        /// Id of the request.
        request: RequestId,
        /// PSM of the new listener, or the reason of the failure.
        psm: Result<Psm, ListenFailure>,
    },
    /// A peer opened a channel.
    Incoming {
        /// Channel.
        channel: ChannelId,
        /// PSM of the listener.
        psm: Psm,
        /// Address of the peer.
        peer: DeviceAddress,
        /// Limits for sending.
        limits: SendLimits,
        /// Whether the adapter is the central of the connection.
        is_central: bool,
    },
    /// A requested channel is open.
    Connected {
        /// Id of the request.
        request: RequestId,
        /// Channel.
        channel: ChannelId,
        /// Limits for sending.
        limits: SendLimits,
        /// Whether the adapter is the central of the connection.
        is_central: bool,
    },
    /// A requested channel could not be opened.
    ConnectFailed {
        /// Id of the request.
        request: RequestId,
        /// Reason of the failure.
        why: ConnectFailure,
    },
    /// The oldest queued bytes of the channel have arrived, which makes room for as many bytes.
    Sent {
        /// Channel.
        channel: ChannelId,
        /// Number of bytes that arrived.
        bytes: usize,
    },
    /// An SDU was received.
    Received {
        /// Channel.
        channel: ChannelId,
        /// Content of the SDU.
        sdu: Vec<u8>,
    },
    /// The channel is down: the peer closed it, or the connection was lost.
    Closed {
        /// Channel.
        channel: ChannelId,
    },
}

/// One received advertisement.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReceivedAdvertisement {
    /// Address of the advertising device.
    pub device: DeviceAddress,
    /// Service data of the advertisement.
    pub advertisement: Advertisement,
    /// Name in the scan response.
    pub name: String,
    /// Received signal strength, in dBm.
    pub rssi_dbm: i16,
}

/// Reasons why an adapter cannot listen on a PSM.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ListenFailure {
    /// Another listener of the adapter uses the PSM.
    Taken,
    /// All 128 PSMs are in use.
    NoneFree,
    /// The adapter is off or missing.
    Unavailable,
}

/// Reasons why a channel could not be opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ConnectFailure {
    /// The peer has no listener on the PSM.
    Refused,
    /// The connection was lost while the channel was being opened.
    LinkLost,
    /// The adapter is off or missing.
    Unavailable,
}

/// Protocol violations of an adapter. The air disconnects the client; other clients are not affected.
#[derive(Clone, Copy, Debug, thiserror::Error, PartialEq, Eq)]
pub enum Violation {
    /// The PSM is outside 0x80 to 0xff.
    #[error("a psm out of range")]
    Psm,
    /// The receive MTU is below 23 bytes.
    #[error("a receive mtu under 23 bytes")]
    Mtu,
    /// The name does not fit into the scan response.
    #[error("a name over 29 bytes")]
    Name,
    /// The adapter has too many advertisements or pending connects.
    #[error("too many requests at once")]
    TooManyRequests,
    /// The connection interval is out of the range of Bluetooth, or too long for the supervision timeout.
    #[error("a connection interval out of range")]
    Interval,
    /// The id belongs to a request that is pending.
    #[error("a request that is already pending")]
    DuplicateRequest,
    /// The SDU is empty, or larger than the peer's MTU.
    #[error("an sdu the channel cannot carry")]
    SduSize,
    /// The SDU was sent although the send queue had no room for it.
    #[error("an sdu sent without room for it")]
    NoRoom,
    /// The adapter reported reading an SDU that was never received.
    #[error("an sdu reported as read that was never received")]
    NothingToRead,
}

/// Serializes [`AdapterState`]: the radio interface itself does not depend on serde.
mod state {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use zenoh_link_ble_radio::AdapterState;

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
