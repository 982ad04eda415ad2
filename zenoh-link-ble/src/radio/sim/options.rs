//! Owns what can be set about a simulated air, and the constants of its hosts' Bluetooth stacks.
use std::time::Duration;

use super::{
    condition::Condition,
    phy::{LlPayload, Phy},
};

/// How many packets a controller takes ahead of the air. What it took cannot be overtaken by what is more urgent.
const CONTROLLER_PACKETS: usize = 4;
/// The least a controller takes ahead, in bytes: eight of the shortest packets.
const CONTROLLER_BYTES: usize = 8 * 27;

/// How many bytes of unread SDUs a receiver keeps before it gives no more credits (a kernel's `SO_RCVBUF`).
pub const RECEIVE_BUFFER_BYTES: usize = 64 * 1024;

/// How much of that a link may count on: as on Linux with its default settings. (Here nothing would be lost beyond it.)
pub const KEPT_UNREAD_BYTES: usize = 12_500;

/// The smallest receive MTU an LE channel may have (Core Specification, Vol 3, Part A, 4.22).
pub const MIN_MTU: u16 = 23;

/// The part of a scan response a name may take: 31 bytes less the field's two of length and type.
pub const MAX_NAME_BYTES: usize = 29;

/// The mean time between two advertising events; each is up to [`ADVERTISING_DELAY`] later (Vol 6, Part B, 4.4.2.2).
pub const ADVERTISING_INTERVAL: Duration = Duration::from_millis(100);

/// The random delay of an advertising event.
pub const ADVERTISING_DELAY: Duration = Duration::from_millis(10);

/// A scan reports the same device no more often than this.
pub const SIGHTING_INTERVAL: Duration = Duration::from_millis(200);

/// From the connect packet to the first connection event.
pub const TRANSMIT_WINDOW: Duration = Duration::from_micros(2500);

/// Connection events that go to the exchange of versions, features and data length before a channel is asked for.
pub const SETUP_EVENTS: u8 = 3;

/// A new link on which nothing is heard for so many intervals was never made (Vol 6, Part B, 4.5.2).
pub const ESTABLISH_INTERVALS: u32 = 6;

/// How long a link without a channel is kept. (Linux keeps it for 2 s; shorter here, so that tests see the end.)
pub const LINGER: Duration = Duration::from_millis(200);

/// What a simulated air is made with. `AirOptions::default()` is a room with Bluetooth 4.2 radios.
#[derive(Clone, Debug)]
pub struct AirOptions {
    /// Where chance begins: the same seed and the same commands give the same events.
    pub seed: u64,
    /// How good the air is. Default: room.
    pub condition: Condition,
    /// The physical layer of every link. Default: 1M.
    pub phy: Phy,
    /// The largest link-layer payload. Default: 251 bytes.
    pub pdu: LlPayload,
    /// The connection interval, 7.5 ms to 4 s. Default: 30 ms, as BlueZ asks for.
    pub interval: Duration,
    /// A link on which nothing was heard for so long is down, 100 ms to 32 s. Default: 2 s (BlueZ's own: 420 ms).
    pub supervision_timeout: Duration,
    /// The largest piece of an SDU in one L2CAP frame, 23 to 65533 bytes. Default: 247, one full packet.
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
            supervision_timeout: Duration::from_secs(2),
            mps: 247,
        }
    }
}

/// A value no Bluetooth link could have.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum AirOptionsError {
    /// The interval is out of range.
    #[error("a connection interval of {0:?} is out of range: use 7.5ms to 4s")]
    Interval(Duration),
    /// The supervision timeout is out of range, or not longer than two intervals.
    #[error("a supervision timeout of {0:?} is out of range: use 100ms to 32s, and more than two intervals")]
    SupervisionTimeout(Duration),
    /// The frame size is out of range.
    #[error("an mps of {0} is out of range: use 23 to 65533 bytes")]
    Mps(u16),
}

impl AirOptions {
    /// Whether a Bluetooth link could have these values.
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
        if possible.mps != self.mps {
            return Err(AirOptionsError::Mps(self.mps));
        }
        Ok(())
    }

    /// How many bytes a controller takes ahead.
    pub(super) fn ahead_bytes(&self) -> usize {
        CONTROLLER_BYTES.max(CONTROLLER_PACKETS * self.pdu.bytes())
    }

    /// The nearest values that a Bluetooth link could have (Core Specification, Vol 6, Part B, 4.5.1 and 4.5.2).
    pub(super) fn clamped(mut self) -> Self {
        let ms = Duration::from_millis;
        self.interval = self.interval.clamp(Duration::from_micros(7500), ms(4000));
        let shortest = ms(100).max(2 * self.interval + ms(1));
        self.supervision_timeout = self.supervision_timeout.clamp(shortest, ms(32_000));
        self.mps = self.mps.clamp(23, 65533);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_possible() {
        assert_eq!(AirOptions::default().check(), Ok(()));
    }

    #[test]
    fn what_no_link_could_have_is_named() {
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
