//! Encodes and decodes RECT's advertisement: ten bytes of service data which announce that a node listens on a PSM.
//!
//! A legacy advertisement has 31 bytes. The flags take 3 and the header of 128-bit service data takes 18, which leaves 10
//! (Core Specification, Vol 3, Part C, 11). The readable name is in the scan response.
use serde::{Deserialize, Serialize};

use crate::address::Psm;

/// The 128-bit UUID of RECT's service data, as 16 bytes, most significant first.
pub const SERVICE_UUID: u128 = 0x52454354_7a65_4e6f_9a68_424c45313030;

/// Size of the service data, in bytes.
pub const SIZE: usize = 10;

const VERSION: u8 = 1;
const PLAIN: u8 = 0b0001;

/// The content of a listener's advertisement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Advertisement {
    /// The PSM on which the node listens.
    pub psm: Psm,
    /// Whether the node accepts only plain links, with one bare batch per SDU and without a hello (a microcontroller).
    pub plain: bool,
    /// CRC-32 (IEEE) of the node's name, which suffices to find it. The hello confirms the complete name.
    pub name_hash: u32,
    /// Hash of the fleet's name; 0 if no fleet is configured.
    pub fleet_hash: u16,
    /// A number that changes each time the node starts, so that a restarted node can be distinguished from the earlier run.
    pub incarnation: u16,
}

/// Why service data is not a valid advertisement.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum AdvertisementError {
    /// The data has the wrong length.
    #[error("{0} bytes of service data, but an advertisement has {SIZE}")]
    Length(usize),
    /// The version is unknown to this program: update it.
    #[error("version {0} of the advertisement is unknown: update this program")]
    Version(u8),
    /// The PSM is not in LE's dynamic range.
    #[error("psm {0} is out of range: it must be 128 to 255")]
    Psm(u8),
}

impl Advertisement {
    /// Returns the hash of a node's name, as advertised.
    pub fn hash_of_name(name: &str) -> u32 {
        crc32fast::hash(name.as_bytes())
    }

    /// Returns the hash of a fleet's name, as advertised: the CRC-32 folded to 16 bits, and never 0, which means no fleet.
    pub fn hash_of_fleet(fleet: &str) -> u16 {
        let hash = crc32fast::hash(fleet.as_bytes());
        ((hash >> 16) as u16 ^ hash as u16).max(1)
    }

    /// Returns whether the advertisement can be that of the node with that name.
    pub fn matches_name(&self, name: &str) -> bool {
        self.name_hash == Self::hash_of_name(name)
    }

    /// Encodes the advertisement as service data.
    pub fn encode(&self) -> [u8; SIZE] {
        let mut data = [0; SIZE];
        data[0] = VERSION << 4 | if self.plain { PLAIN } else { 0 };
        data[1] = self.psm.number() as u8;
        data[2..6].copy_from_slice(&self.name_hash.to_le_bytes());
        data[6..8].copy_from_slice(&self.fleet_hash.to_le_bytes());
        data[8..10].copy_from_slice(&self.incarnation.to_le_bytes());
        data
    }

    /// Decodes service data from an untrusted device. Unknown flags are ignored, so that later versions may add some.
    ///
    /// # Errors
    /// Fails if the length, the version or the PSM is not valid.
    pub fn decode(data: &[u8]) -> Result<Self, AdvertisementError> {
        let data: &[u8; SIZE] = data
            .try_into()
            .map_err(|_| AdvertisementError::Length(data.len()))?;
        let [head, psm, n0, n1, n2, n3, f0, f1, i0, i1] = *data;
        if head >> 4 != VERSION {
            return Err(AdvertisementError::Version(head >> 4));
        }
        Ok(Self {
            psm: Psm::new(u16::from(psm)).ok_or(AdvertisementError::Psm(psm))?,
            plain: head & PLAIN != 0,
            name_hash: u32::from_le_bytes([n0, n1, n2, n3]),
            fleet_hash: u16::from_le_bytes([f0, f1]),
            incarnation: u16::from_le_bytes([i0, i1]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Advertisement {
        Advertisement {
            psm: Psm::new(0x95).expect("valid"),
            plain: false,
            name_hash: Advertisement::hash_of_name("wombat-2"),
            fleet_hash: 0x1234,
            incarnation: 7,
        }
    }

    #[test]
    fn advertisement_decodes_to_what_was_encoded() {
        for plain in [false, true] {
            let sent = Advertisement { plain, ..sample() };
            assert_eq!(Advertisement::decode(&sent.encode()), Ok(sent));
        }
    }

    #[test]
    fn every_length_except_ten_is_rejected() {
        for length in (0..40).filter(|n| *n != SIZE) {
            let data = vec![0x10; length];
            assert_eq!(
                Advertisement::decode(&data),
                Err(AdvertisementError::Length(length))
            );
        }
    }

    #[test]
    fn other_version_and_low_psm_are_rejected() {
        let mut data = sample().encode();
        data[0] = 0x20;
        assert_eq!(
            Advertisement::decode(&data),
            Err(AdvertisementError::Version(2))
        );
        let mut data = sample().encode();
        data[1] = 0x7f;
        assert_eq!(
            Advertisement::decode(&data),
            Err(AdvertisementError::Psm(0x7f))
        );
    }

    #[test]
    fn name_is_matched_by_its_hash() {
        assert!(sample().matches_name("wombat-2"));
        assert!(!sample().matches_name("wombat-3"));
    }
}
