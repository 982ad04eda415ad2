//! Defines the options of a simulated air, and the constants of its Bluetooth hosts.
use std::time::Duration;

use super::{
    arbitration::Arbitration,
    condition::Condition,
    phy::{LlPayload, Phy},
};

/// Number of packets that a controller accepts ahead of transmission. They cannot be overtaken by more urgent data.
const CONTROLLER_PACKETS: usize = 4;
/// Minimum number of bytes that a controller accepts ahead of transmission: eight of the shortest packets.
const CONTROLLER_BYTES: usize = 8 * 27;

/// Number of bytes of unread SDUs that a receiver buffers before it grants no more credits (a kernel's `SO_RCVBUF`).
pub const RECEIVE_BUFFER_BYTES: usize = 64 * 1024;

/// Part of the receive buffer, in bytes, that a link can rely on: the same as on Linux with its default settings. (The
/// simulated air loses no data beyond it.)
pub const GUARANTEED_RECEIVE_BYTES: usize = 12_500;

/// Smallest receive MTU of an LE channel (Core Specification, Vol 3, Part A, 4.22).
pub const MIN_MTU: u16 = 23;

/// Maximum length of a name in a scan response: 31 bytes minus 2 for the field's length and type.
pub const MAX_NAME_BYTES: usize = 29;

/// Maximum random delay of an advertising event, in addition to the advertising interval (Vol 6, Part B, 4.4.2.2).
pub const ADVERTISING_DELAY: Duration = Duration::from_millis(10);

/// Minimum time between two reports of the same advertisement in a scan.
pub const REPORT_INTERVAL: Duration = Duration::from_millis(200);

/// Minimum time from the connect packet to the first connection event.
pub const TRANSMIT_WINDOW: Duration = Duration::from_micros(2500);

/// Number of connection events used for the exchange of versions, features and data length before a channel is
/// requested.
pub const SETUP_EVENTS: u8 = 3;

/// Number of intervals without a received packet after which a new connection counts as not established (Vol 6, Part B,
/// 4.5.2).
pub const ESTABLISH_INTERVALS: u32 = 6;

/// Maximum deviation of a clock that the Core Specification allows (Vol 6, Part B, 4.2.2).
const MAX_CLOCK_DRIFT_PPM: u16 = 500;

/// Options of a simulated air. The defaults describe a room with Bluetooth 4.2 radios.
#[derive(Clone, Debug)]
pub struct AirOptions {
    /// Seed of the random generator: the same seed and the same commands produce the same events. Default: 1.
    pub seed: u64,
    /// Radio condition. Default: room.
    pub condition: Condition,
    /// Physical layer of every link. Default: 1M.
    pub phy: Phy,
    /// Largest link-layer payload. Default: 251 bytes.
    pub pdu: LlPayload,
    /// Connection interval, 7.5 ms to 4 s. Default: 30 ms, as BlueZ requests.
    pub interval: Duration,
    /// Whether a host can change the interval of an open connection. Default: true, as with Linux 6.11 and later.
    pub changes_open_connections: bool,
    /// Advertising interval, 20 ms to 10.24 s. Default: 100 ms.
    pub advertising_interval: Duration,
    /// Time after which a scan changes to the next advertising channel, 2.5 ms to 10.24 s. Default: 60 ms.
    pub scan_interval: Duration,
    /// Time for which a scan listens on each channel, 2.5 ms to the scan interval. Default: 45 ms.
    pub scan_window: Duration,
    /// Maximum deviation of each adapter's clock, in parts per million, 0 to 500. Default: 20, as of common
    /// crystals.
    pub max_clock_drift_ppm: u16,
    /// How a radio is shared by overlapping connection events of different clocks. Default: first come.
    pub arbitration: Arbitration,
    /// Supervision timeout: a connection on which no packet was received for this time is down. 100 ms to 32 s.
    /// Default: 2 s (default of BlueZ: 420 ms).
    pub supervision_timeout: Duration,
    /// Largest piece of an SDU in one L2CAP frame, 23 to 65533 bytes. Default: 247, which fills one packet.
    pub mps: u16,
}

impl Default for AirOptions {
    fn default() -> Self {
        Self {
            seed: 1,
            condition: Condition::default(),
            phy: Phy::default(),
            pdu: LlPayload::default(),
            interval: Duration::from_millis(30),
            changes_open_connections: true,
            advertising_interval: Duration::from_millis(100),
            scan_interval: Duration::from_millis(60),
            scan_window: Duration::from_millis(45),
            max_clock_drift_ppm: 20,
            arbitration: Arbitration::default(),
            supervision_timeout: Duration::from_secs(2),
            mps: 247,
        }
    }
}

/// Option values outside the range of Bluetooth.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum AirOptionsError {
    /// The interval is out of range.
    #[error("a connection interval of {0:?} is out of range: use 7.5ms to 4s")]
    Interval(Duration),
    /// The supervision timeout is out of range, or not longer than two intervals.
    #[error("a supervision timeout of {0:?} is out of range: use 100ms to 32s, and more than two intervals")]
    SupervisionTimeout(Duration),
    /// The advertising interval is out of range.
    #[error("an advertising interval of {0:?} is out of range: use 20ms to 10.24s")]
    AdvertisingInterval(Duration),
    /// The scan interval or the scan window is out of range.
    #[error("a scan window of {0:?} in an interval of {1:?} is out of range: use 2.5ms to 10.24s, and a window within the interval")]
    Scan(Duration, Duration),
    /// The drift of the clocks is out of range.
    #[error("a clock drift of {0} ppm is out of range: use 0 to 500")]
    ClockDrift(u16),
    /// The frame size is out of range.
    #[error("an mps of {0} is out of range: use 23 to 65533 bytes")]
    Mps(u16),
}

impl AirOptions {
    /// Checks that the values are in the range of Bluetooth.
    ///
    /// # Errors
    /// Returns [`AirOptionsError`] with the first value that is not.
    pub fn check(&self) -> Result<(), AirOptionsError> {
        let possible = self.clone().clamped();
        if possible.interval != self.interval {
            return Err(AirOptionsError::Interval(self.interval));
        }
        if possible.supervision_timeout != self.supervision_timeout {
            return Err(AirOptionsError::SupervisionTimeout(
                self.supervision_timeout,
            ));
        }
        if possible.advertising_interval != self.advertising_interval {
            return Err(AirOptionsError::AdvertisingInterval(
                self.advertising_interval,
            ));
        }
        let scan = (self.scan_window, self.scan_interval);
        if (possible.scan_window, possible.scan_interval) != scan {
            return Err(AirOptionsError::Scan(scan.0, scan.1));
        }
        if possible.max_clock_drift_ppm != self.max_clock_drift_ppm {
            return Err(AirOptionsError::ClockDrift(self.max_clock_drift_ppm));
        }
        if possible.mps != self.mps {
            return Err(AirOptionsError::Mps(self.mps));
        }
        Ok(())
    }

    /// Returns the number of bytes that a controller accepts ahead of transmission.
    pub(super) fn ahead_bytes(&self) -> usize {
        CONTROLLER_BYTES.max(CONTROLLER_PACKETS * self.pdu.bytes())
    }

    /// Returns the nearest values in the range of Bluetooth (Core Specification, Vol 6, Part B, 4.5.1 and 4.5.2).
    pub(super) fn clamped(mut self) -> Self {
        let ms = Duration::from_millis;
        self.interval = self.interval.clamp(Duration::from_micros(7500), ms(4000));
        let shortest = ms(100).max(2 * self.interval + ms(1));
        self.supervision_timeout = self.supervision_timeout.clamp(shortest, ms(32_000));
        self.advertising_interval = self.advertising_interval.clamp(ms(20), ms(10_240));
        let shortest = Duration::from_micros(2500);
        self.scan_interval = self.scan_interval.clamp(shortest, ms(10_240));
        self.scan_window = self.scan_window.clamp(shortest, self.scan_interval);
        self.max_clock_drift_ppm = self.max_clock_drift_ppm.min(MAX_CLOCK_DRIFT_PPM);
        self.mps = self.mps.clamp(23, 65533);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accepts_the_defaults() {
        assert_eq!(AirOptions::default().check(), Ok(()));
    }

    #[test]
    fn rejects_values_outside_the_range_of_bluetooth() {
        let good = AirOptions::default;
        let interval = Duration::from_millis(5);
        assert_eq!(
            AirOptions { interval, ..good() }.check(),
            Err(AirOptionsError::Interval(interval))
        );
        let supervision_timeout = Duration::from_millis(420);
        let interval = Duration::from_millis(400);
        assert_eq!(
            AirOptions {
                interval,
                supervision_timeout,
                ..good()
            }
            .check(),
            Err(AirOptionsError::SupervisionTimeout(supervision_timeout))
        );
        assert_eq!(
            AirOptions { mps: 22, ..good() }.check(),
            Err(AirOptionsError::Mps(22))
        );
    }
}
