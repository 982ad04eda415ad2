//! Computes the airtime of packets from the LE PHY and the size of the link-layer payload.
//!
//! Source of the values: Bluetooth Core Specification 5.4, Vol 6, Part B, 2.1 (uncoded packets), 2.2 (coded packets),
//! 4.1 (spacing).
use std::{fmt, str::FromStr, time::Duration};

use serde::{Deserialize, Serialize};

/// Inter-frame space: the pause between two packets of one connection event.
pub const INTER_FRAME_SPACE: Duration = Duration::from_micros(150);

/// Bytes of a packet besides preamble and payload: access address 4, header 2, CRC 3.
const PACKET_OVERHEAD_BYTES: usize = 4 + 2 + 3;

/// Physical layer of every link of the simulated air.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phy {
    /// 1 Mbit/s, supported by every LE radio; the only PHY of a Raspberry Pi 3.
    #[default]
    #[serde(rename = "1m")]
    Le1M,
    /// 2 Mbit/s, Bluetooth 5.
    #[serde(rename = "2m")]
    Le2M,
    /// Coded, two symbols per bit: 500 kbit/s.
    #[serde(rename = "coded-s2")]
    CodedS2,
    /// Coded, eight symbols per bit: 125 kbit/s, long range.
    #[serde(rename = "coded-s8")]
    CodedS8,
}

/// Largest payload of a link-layer packet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum LlPayload {
    /// 27 bytes: Bluetooth 4.0 and 4.1, such as a Raspberry Pi 3B.
    Bytes27,
    /// 251 bytes: with the data length extension of Bluetooth 4.2.
    #[default]
    Bytes251,
}

/// The text is not the name of a PHY.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("{0:?} is not a PHY: use 1m, 2m, coded-s2 or coded-s8")]
pub struct PhyError(String);

/// The text is not a valid size of a link-layer payload.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("{0:?} is not a link-layer payload size: use 27 or 251")]
pub struct LlPayloadError(String);

impl Phy {
    /// All PHYs, the most common one first.
    pub const ALL: [Self; 4] = [Self::Le1M, Self::Le2M, Self::CodedS2, Self::CodedS8];

    /// Returns the airtime of a packet with `payload_bytes`.
    pub fn airtime(self, payload_bytes: usize) -> Duration {
        let body = (PACKET_OVERHEAD_BYTES + payload_bytes) as u64;
        // The coded PHYs send preamble 80, access address 256, coding indicator 16 and its tail 24 us at a fixed rate,
        // followed by header, payload, CRC and a tail of three bits at S us per bit.
        let coded_body = 5 + payload_bytes as u64;
        let micros = match self {
            Self::Le1M => (1 + body) * 8,
            Self::Le2M => (2 + body) * 4,
            Self::CodedS2 => 376 + coded_body * 8 * 2 + 3 * 2,
            Self::CodedS8 => 376 + coded_body * 8 * 8 + 3 * 8,
        };
        Duration::from_micros(micros)
    }

    /// Returns the duration of one exchange: the central's packet, the peripheral's response, and the pause after each.
    pub fn exchange(self, central_bytes: usize, peripheral_bytes: usize) -> Duration {
        self.airtime(central_bytes) + self.airtime(peripheral_bytes) + 2 * INTER_FRAME_SPACE
    }

    /// Returns the number of bits of a packet that must all be correct for the packet to be received.
    pub fn bits(payload_bytes: usize) -> u32 {
        u32::try_from((PACKET_OVERHEAD_BYTES + payload_bytes) * 8).unwrap_or(u32::MAX)
    }
}

impl LlPayload {
    /// Returns the payload size in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::Bytes27 => 27,
            Self::Bytes251 => 251,
        }
    }
}

impl FromStr for Phy {
    type Err = PhyError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL
            .into_iter()
            .find(|phy| phy.to_string() == text)
            .ok_or_else(|| PhyError(text.to_owned()))
    }
}

impl fmt::Display for Phy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Le1M => "1m",
            Self::Le2M => "2m",
            Self::CodedS2 => "coded-s2",
            Self::CodedS8 => "coded-s8",
        })
    }
}

impl FromStr for LlPayload {
    type Err = LlPayloadError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "27" => Ok(Self::Bytes27),
            "251" => Ok(Self::Bytes251),
            _ => Err(LlPayloadError(text.to_owned())),
        }
    }
}

impl fmt::Display for LlPayload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.bytes().fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn computes_the_exchange_time_of_the_specification() {
        for (phy, bytes, micros) in [
            (Phy::Le1M, 27, 676),
            (Phy::Le1M, 251, 2468),
            (Phy::Le2M, 27, 496),
            (Phy::Le2M, 251, 1392),
            (Phy::CodedS2, 251, 5240),
            (Phy::CodedS8, 251, 17804),
        ] {
            assert_eq!(
                phy.exchange(bytes, 0),
                Duration::from_micros(micros),
                "{phy}, {bytes} bytes"
            );
        }
    }

    #[test]
    fn parses_the_displayed_name_of_every_phy_and_payload_size() {
        for phy in Phy::ALL {
            assert_eq!(phy.to_string().parse(), Ok(phy));
        }
        for payload in [LlPayload::Bytes27, LlPayload::Bytes251] {
            assert_eq!(payload.to_string().parse(), Ok(payload));
        }
        assert!("3m".parse::<Phy>().is_err());
        assert!("100".parse::<LlPayload>().is_err());
    }
}
