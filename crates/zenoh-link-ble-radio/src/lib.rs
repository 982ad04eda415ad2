//! Defines the interface between a link and a radio: the operations that a Bluetooth adapter must support, with the
//! addresses, advertisements and connection intervals that both use.
//!
//! Two crates implement [`Radio`]: `zenoh-link-ble-bluez` (the Bluetooth stack of Linux) and `zenoh-link-ble-air` (the
//! simulated air). The test suite `contract` of `zenoh-link-ble` runs on both. This crate does no I/O.
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used))]
pub mod address;
pub mod advertisement;
pub mod interval;
pub mod interval_table;
#[cfg(test)]
mod vectors;

use std::{sync::Arc, time::Duration};

use async_trait::async_trait;

use crate::{
    address::{DeviceAddress, Psm},
    advertisement::Advertisement,
    interval::ConnectionInterval,
};

/// Availability of an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterState {
    /// No adapter of that name exists: it is unplugged or disabled in the firmware, or the service behind it is down.
    Missing,
    /// The adapter exists, but it is powered off or blocked.
    Off,
    /// The adapter can advertise, scan, listen and connect.
    On,
}

/// Protection of a channel's traffic (BlueZ: `BT_SECURITY`). Default: [`Security::Low`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Security {
    /// No encryption by Bluetooth. Zenoh's own authentication and access control still apply.
    #[default]
    Low,
    /// Encrypted; the devices pair without user confirmation.
    Medium,
    /// Encrypted; the devices pair with a passkey that both sides know.
    High,
}

/// Options with which a channel is opened or accepted.
#[derive(Clone, Copy, Debug)]
pub struct ChannelOptions {
    /// Largest SDU that this end receives, in bytes. On old kernels, a large value also increases the number of
    /// credits.
    pub recv_mtu: u16,
    /// Required protection of the channel.
    pub security: Security,
    /// Passkey that both sides enter when they pair for [`Security::High`]: 0 to 999,999.
    pub passkey: Option<u32>,
}

/// One advertisement received while scanning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdvertisingReport {
    /// Address of the advertising device.
    pub device: DeviceAddress,
    /// RECT's service data, if the advertisement contains any.
    pub advertisement: Option<Advertisement>,
    /// Received signal strength in dBm, if it is known.
    pub rssi_dbm: Option<i16>,
}

/// Reasons why a radio operation failed.
#[derive(Debug, thiserror::Error)]
pub enum RadioError {
    /// No adapter of that name exists.
    #[error("there is no bluetooth adapter {adapter}: {advice}")]
    NoAdapter {
        /// Name of the adapter as the user wrote it.
        adapter: String,
        /// Available adapters, and advice for the user.
        advice: String,
    },
    /// The adapter is powered off or blocked.
    #[error("the bluetooth adapter {adapter} is switched off: run `bluetoothctl power on` (or `rfkill unblock bluetooth`)")]
    AdapterOff {
        /// Name of the adapter.
        adapter: String,
    },
    /// The service behind the radio does not answer.
    #[error("{service} does not answer: {advice}")]
    NoService {
        /// Name of the service: `bluetoothd`, the system D-Bus or the simulated air.
        service: &'static str,
        /// Advice for the user.
        advice: String,
    },
    /// The user lacks the permission for the operation.
    #[error("no permission to {action}: {advice}")]
    NotPermitted {
        /// Operation that failed.
        action: &'static str,
        /// Advice for the user.
        advice: String,
    },
    /// Another listener of this adapter uses the PSM.
    #[error("psm {0} is already in use on this adapter: choose another one, or omit psm=")]
    PsmTaken(Psm),
    /// The peer has no listener on the PSM, or it refused the channel.
    #[error("{peer} refused the channel on psm {psm}: is its router running?")]
    Refused {
        /// Address of the peer.
        peer: DeviceAddress,
        /// PSM to which the channel was requested.
        psm: Psm,
    },
    /// The operation did not complete in time.
    #[error("{action} took longer than {limit:?}")]
    TimedOut {
        /// Operation that timed out.
        action: &'static str,
        /// Timeout of the operation.
        limit: Duration,
    },
    /// The channel is down: the peer closed it or went out of range, or an adapter became unavailable.
    #[error("the channel to {peer} is down")]
    ChannelDown {
        /// Address of the peer.
        peer: DeviceAddress,
        /// Reason given by the operating system, if any.
        #[source]
        source: Option<std::io::Error>,
    },
    /// An SDU is larger than the receive buffer or the channel's limit.
    #[error("an sdu of {size} bytes exceeds the channel's limit of {limit} bytes")]
    SduTooLarge {
        /// Size of the SDU in bytes.
        size: usize,
        /// Limit in bytes.
        limit: usize,
    },
    /// Any other error of the operating system.
    #[error("{action} failed")]
    System {
        /// Operation that failed.
        action: &'static str,
        /// Error of the operating system.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl RadioError {
    /// Returns whether the adapter, or the service behind it, is unavailable now and may become available later.
    pub fn is_adapter_unavailable(&self) -> bool {
        matches!(
            self,
            Self::NoAdapter { .. } | Self::AdapterOff { .. } | Self::NoService { .. }
        )
    }
}

/// A local Bluetooth adapter.
///
/// Methods fail with [`RadioError`]. A method that waits for a peer or for a change has no timeout of its own: the
/// caller applies one. The future can be dropped at any await point without leaving a pending operation behind.
#[async_trait]
pub trait Radio: Send + Sync {
    /// Returns the adapter's name, such as `hci0` or `sim-wombat-1`.
    fn name(&self) -> &str;

    /// Identifies the adapter within this process: radios with equal ids share its connections.
    fn id(&self) -> String;

    /// Returns the adapter's own address.
    ///
    /// # Errors
    /// Fails if the adapter is missing. With BlueZ, it also fails if the adapter is switched off.
    async fn address(&self) -> Result<DeviceAddress, RadioError>;

    /// Returns whether the adapter can be used now.
    async fn state(&self) -> AdapterState;

    /// Waits until [`Radio::state`] may have changed: the power, the presence of the adapter, or a restart of the
    /// service behind it. Spurious wake-ups are allowed, and a change may be missed. The caller therefore checks the
    /// state at intervals as well.
    async fn changed(&self);

    /// Returns a counter that increases when listeners and advertisements were lost although the adapter is on: because
    /// its service was restarted, or because the adapter was unplugged and plugged in again. The caller then listens
    /// and advertises again.
    fn epoch(&self) -> u64 {
        0
    }

    /// Sends connectable advertisements until the guard is dropped. The scan response contains `name`.
    async fn advertise(
        &self,
        advertisement: &Advertisement,
        name: &str,
    ) -> Result<Box<dyn AdvertisingGuard>, RadioError>;

    /// Scans until the returned scan is dropped. Several scans of one adapter may run at the same time.
    async fn scan(&self) -> Result<Box<dyn Scan>, RadioError>;

    /// Returns the name in the device's scan response, if it is known.
    async fn device_name(&self, device: DeviceAddress) -> Option<String>;

    /// Accepts channels on `psm`, or on a PSM that the system chooses if `psm` is `None`.
    ///
    /// # Errors
    /// Fails with [`RadioError::PsmTaken`] if another listener uses `psm`.
    async fn listen(
        &self,
        psm: Option<Psm>,
        options: ChannelOptions,
    ) -> Result<Box<dyn ChannelListener>, RadioError>;

    /// Opens a channel to `peer`. The caller runs at most one connect per adapter at a time and applies a timeout to
    /// it. Dropping the future cancels the attempt.
    ///
    /// # Errors
    /// Fails with [`RadioError::Refused`] if the peer has no listener on `psm`, and with [`RadioError::ChannelDown`] if
    /// the connection is lost while the channel is being opened.
    async fn connect(
        &self,
        peer: DeviceAddress,
        psm: Psm,
        options: ChannelOptions,
    ) -> Result<Arc<dyn Channel>, RadioError>;

    /// Returns the connection interval that the radio uses unless another one is set.
    fn default_interval(&self) -> ConnectionInterval;

    /// Returns whether [`Radio::set_interval`] changes the interval of an open connection, too, and not only of the next one.
    fn changes_open_connections(&self) -> bool;

    /// Sets the interval of connections to `peer` of which this adapter is the central: of the next one, and of an
    /// existing one if [`Radio::changes_open_connections`]. Returns `false` if the radio does not permit it.
    async fn set_interval(&self, peer: DeviceAddress, interval: ConnectionInterval) -> bool;

    /// Closes the connection to the device, with all channels on it, if there is one. The system keeps a connection without
    /// channels. Returns when the connection is closed, or cannot be.
    async fn disconnect(&self, peer: DeviceAddress);
}

/// Keeps an advertisement on the air until it is dropped.
pub trait AdvertisingGuard: Send + Sync {}

/// A running scan.
#[async_trait]
pub trait Scan: Send {
    /// Waits for the next advertisement. A device that continues to advertise is reported repeatedly, at most a few
    /// times per second, so that the caller knows when it was last received.
    ///
    /// # Errors
    /// Fails when the adapter becomes unavailable.
    async fn next(&mut self) -> Result<AdvertisingReport, RadioError>;
}

/// Accepts incoming channels until it is dropped.
#[async_trait]
pub trait ChannelListener: Send + Sync {
    /// Returns the PSM of the listener.
    fn psm(&self) -> Psm;

    /// Waits for the next incoming channel.
    ///
    /// # Errors
    /// Fails when the adapter becomes unavailable.
    async fn accept(&self) -> Result<Arc<dyn Channel>, RadioError>;
}

/// An open LE L2CAP connection-oriented channel. SDUs arrive complete and in order.
///
/// `send` and `recv` may run concurrently in two tasks. Dropping the channel closes it immediately.
#[async_trait]
pub trait Channel: Send + Sync {
    /// Returns the address of the peer.
    fn peer(&self) -> DeviceAddress;

    /// Returns the name of the local adapter.
    fn adapter(&self) -> &str;

    /// Returns the size of the largest SDU that can be sent, in bytes.
    fn send_mtu(&self) -> usize;

    /// Returns whether the local adapter is the central of the BLE connection, or `None` if that is not known. It usually
    /// is if this side opened the channel; if both sides dialled at the same time, the connection may be the peer's.
    fn is_central(&self) -> Option<bool>;

    /// Returns how many bytes of received SDUs are guaranteed to be buffered while `recv` is not called. Each SDU
    /// counts 24 bytes in addition to its own size (`SDU_OVERHEAD_BYTES` in the crate `link-lanes`).
    fn receive_capacity_bytes(&self) -> usize;

    /// Sends one SDU if the controller and the receiver have room for it. Returns `false` if they do not; wait for
    /// [`Channel::writable`] then and try again.
    ///
    /// An SDU must not be empty, because an empty one would be read as the end of the channel. An SDU that was accepted
    /// cannot be overtaken by a more urgent one. The channel therefore accepts no more than it needs to keep the radio
    /// busy.
    ///
    /// # Errors
    /// Fails if the channel is down, or with [`RadioError::SduTooLarge`] if the SDU is larger than
    /// [`Channel::send_mtu`].
    fn try_send(&self, sdu: &[u8]) -> Result<bool, RadioError>;

    /// Waits until the channel may be writable again after [`Channel::try_send`] returned `false`, or until the channel
    /// is down, so that sending fails at once.
    async fn writable(&self);

    /// Sends one SDU, and waits until the channel is writable if necessary.
    async fn send(&self, sdu: &[u8]) -> Result<(), RadioError> {
        while !self.try_send(sdu)? {
            self.writable().await;
        }
        Ok(())
    }

    /// Receives one SDU into `buffer` and returns its size in bytes.
    ///
    /// # Errors
    /// Fails when the channel is down. If the SDU is larger than `buffer`, the simulated radio fails with
    /// [`RadioError::SduTooLarge`], and a kernel truncates the SDU without an error. A buffer that is one byte larger
    /// than the largest expected SDU detects both.
    async fn recv(&self, buffer: &mut [u8]) -> Result<usize, RadioError>;

    /// Closes both directions; the peer's `recv` fails. SDUs that are still queued may be lost.
    fn shutdown(&self);
}
