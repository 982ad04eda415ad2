//! Owns the seam between the link and a radio: what a Bluetooth adapter must be able to do for it.
//! Two radios implement it: [`bluez`] (Linux's own stack) and [`sim`] (the simulated air). Both pass `contract`.
pub mod bluez;
pub mod sim;

use std::{sync::Arc, time::Duration};

use async_trait::async_trait;

use crate::{
    address::{DeviceAddress, Psm},
    advertisement::Advertisement,
};

/// Whether an adapter can be used now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterState {
    /// There is no adapter of that name (unplugged, switched off in the firmware, or its service is down).
    Missing,
    /// It is there, but powered off or blocked.
    Off,
    /// It can advertise, scan, listen and connect.
    On,
}

/// How a channel's traffic is protected (BlueZ: `BT_SECURITY`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Security {
    /// No encryption by Bluetooth; Zenoh's own authentication and access control still hold.
    #[default]
    Low,
    /// Encrypted, pairing without a person's confirmation.
    Medium,
    /// Encrypted, paired with a passkey that both sides know.
    High,
}

/// What both ends of a channel are opened with.
#[derive(Clone, Copy, Debug)]
pub struct ChannelOptions {
    /// The largest SDU this end takes, in bytes. Large values also mean more credits on old kernels.
    pub recv_mtu: u16,
    /// The security asked for.
    pub security: Security,
    /// What both sides type in when they are paired for [`Security::High`]: at most 999,999.
    pub passkey: Option<u32>,
}

/// One advertisement heard while scanning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sighting {
    /// Who sent it.
    pub device: DeviceAddress,
    /// RECT's part of it, where there is one.
    pub advertisement: Option<Advertisement>,
    /// Received signal strength in dBm, where known.
    pub rssi_dbm: Option<i16>,
}

/// Why a radio could not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum RadioError {
    /// There is no such adapter.
    #[error("there is no bluetooth adapter {adapter}: {advice}")]
    NoAdapter {
        /// Its name as given.
        adapter: String,
        /// What there is, and what to do.
        advice: String,
    },
    /// The adapter is powered off.
    #[error("the bluetooth adapter {adapter} is switched off: run `bluetoothctl power on` (or `rfkill unblock bluetooth`)")]
    AdapterOff {
        /// Its name.
        adapter: String,
    },
    /// The service behind the radio does not answer.
    #[error("{service} does not answer: {advice}")]
    NoService {
        /// `bluetoothd` or the simulated air.
        service: &'static str,
        /// What to do.
        advice: String,
    },
    /// This user may not do it.
    #[error("no permission to {action}: {advice}")]
    NotPermitted {
        /// What was tried.
        action: &'static str,
        /// What to do.
        advice: String,
    },
    /// Another listener of this adapter has that PSM.
    #[error("psm {0} is taken on this adapter: choose another, or leave psm= out")]
    PsmTaken(Psm),
    /// The peer has no listener on that PSM, or refused.
    #[error("{peer} refused the channel on psm {psm}: is its router running?")]
    Refused {
        /// Who refused.
        peer: DeviceAddress,
        /// The PSM dialled.
        psm: Psm,
    },
    /// Nothing came back in time.
    #[error("{action} took longer than {limit:?}")]
    TimedOut {
        /// What was waited for.
        action: &'static str,
        /// The limit that passed.
        limit: Duration,
    },
    /// The channel ended: the peer closed it, went out of range, or an adapter went away.
    #[error("the channel to {peer} is down")]
    ChannelDown {
        /// The other end.
        peer: DeviceAddress,
        /// The system's reason, where it gives one.
        #[source]
        source: Option<std::io::Error>,
    },
    /// An SDU does not fit the receiver's buffer or the channel.
    #[error("an sdu of {size} bytes is over the channel's limit of {limit}")]
    SduTooLarge {
        /// Its size in bytes.
        size: usize,
        /// The limit in bytes.
        limit: usize,
    },
    /// Anything else the system says.
    #[error("{action} failed")]
    System {
        /// What was tried.
        action: &'static str,
        /// The system's own error.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl RadioError {
    /// Whether it is a matter of an adapter, or of the service behind it, that may be there later.
    pub fn is_adapter_away(&self) -> bool {
        matches!(
            self,
            Self::NoAdapter { .. } | Self::AdapterOff { .. } | Self::NoService { .. }
        )
    }
}

/// A local Bluetooth adapter.
///
/// Every method may fail with [`RadioError`]; none blocks for ever: those that wait for a peer are bounded by the
/// caller's timeout and can be dropped at any await point without leaving anything behind.
#[async_trait]
pub trait Radio: Send + Sync {
    /// The adapter's name: `hci0`, `sim-wombat-1`.
    fn name(&self) -> &str;

    /// The adapter's own address. An error when it is missing.
    async fn address(&self) -> Result<DeviceAddress, RadioError>;

    /// Whether it can be used now.
    async fn state(&self) -> AdapterState;

    /// Resolves when [`Radio::state`] may have changed since the call (spurious wake-ups are allowed): power,
    /// unplugging, a restart of the service behind it.
    async fn changed(&self);

    /// Grows when what was set up before is lost although the adapter is on: its service was restarted, it was
    /// unplugged and is back. Whoever listens or advertises does so again.
    fn epoch(&self) -> u64 {
        0
    }

    /// Advertises, connectably, until the guard is dropped. `name` goes to the scan response.
    async fn advertise(
        &self,
        advertisement: &Advertisement,
        name: &str,
    ) -> Result<Box<dyn AdvertisingGuard>, RadioError>;

    /// Scans until the scan is dropped. Several scans of one adapter may run at once.
    async fn scan(&self) -> Result<Box<dyn Scan>, RadioError>;

    /// What that device calls itself, where it is known: the name in its scan response.
    async fn name_of(&self, device: DeviceAddress) -> Option<String>;

    /// Takes channels on `psm`, or on one the system chooses.
    async fn listen(
        &self,
        psm: Option<Psm>,
        options: ChannelOptions,
    ) -> Result<Box<dyn ChannelListener>, RadioError>;

    /// Opens a channel. The caller keeps to one pending connect per adapter and puts a timeout around it; dropping
    /// the future cancels the attempt.
    async fn connect(
        &self,
        peer: DeviceAddress,
        psm: Psm,
        options: ChannelOptions,
    ) -> Result<Arc<dyn Channel>, RadioError>;

    /// Ends whatever connection there is with that device, so that the next connect starts afresh: for after an
    /// opening that went wrong. Does nothing where a failed channel leaves nothing behind.
    async fn disconnect(&self, _peer: DeviceAddress) {}
}

/// Keeps an advertisement on the air; dropping it takes it off.
pub trait AdvertisingGuard: Send + Sync {}

/// A running scan.
#[async_trait]
pub trait Scan: Send {
    /// The next advertisement heard. Each device is reported again while it goes on advertising (at most a few times a
    /// second), so that "just seen" can be told from "seen once". Fails when the adapter goes away.
    async fn next(&mut self) -> Result<Sighting, RadioError>;
}

/// Takes incoming channels until it is dropped.
#[async_trait]
pub trait ChannelListener: Send + Sync {
    /// The PSM it took.
    fn psm(&self) -> Psm;

    /// The next incoming channel. Fails when the adapter goes away.
    async fn accept(&self) -> Result<Arc<dyn Channel>, RadioError>;
}

/// An open LE L2CAP connection-oriented channel: SDUs go out and come in whole and in order.
///
/// `send` and `recv` may run at the same time from two tasks. Dropping the channel closes it at once.
#[async_trait]
pub trait Channel: Send + Sync {
    /// The other end.
    fn peer(&self) -> DeviceAddress;

    /// The local adapter's name.
    fn adapter(&self) -> &str;

    /// The largest SDU that can be sent, in bytes.
    fn send_mtu(&self) -> usize;

    /// How many bytes of received SDUs are surely kept while nobody calls `recv`, each counted with
    /// [`PER_SDU`](crate::lanes::credits::PER_SDU) bytes more.
    fn kept_unread_bytes(&self) -> usize;

    /// Sends one SDU (never an empty one: it would read as the end of the channel) if the controller and the receiver have
    /// room; `false`: try again when [`Channel::has_room`] says so. What it has taken cannot be overtaken, so it takes no
    /// more than it needs to keep the radio busy.
    fn try_send(&self, sdu: &[u8]) -> Result<bool, RadioError>;

    /// Resolves when [`Channel::try_send`] may have got room since it said `false`, or fails now.
    async fn has_room(&self);

    /// Sends one SDU; waits for room.
    async fn send(&self, sdu: &[u8]) -> Result<(), RadioError> {
        while !self.try_send(sdu)? {
            self.has_room().await;
        }
        Ok(())
    }

    /// Receives one SDU into `buffer` and tells its size. Fails when the channel is down, or with
    /// [`RadioError::SduTooLarge`] when it does not fit.
    async fn recv(&self, buffer: &mut [u8]) -> Result<usize, RadioError>;

    /// Closes both directions; the peer's `recv` fails. What was sent and is still queued may be lost.
    fn shutdown(&self);
}
