//! Owns RECT's advertisement: ten bytes of service data that say "a Zenoh link listens here, on this PSM".
//!
//! A legacy advertisement has 31 bytes; flags take 3 and the header of 128-bit service data 18, which leaves 10
//! (Core Specification, Vol 3, Part C, 11). The readable name goes to the scan response.
use serde::{Deserialize, Serialize};

use crate::address::Psm;

/// The 128-bit UUID of RECT's service data, as 16 bytes, most significant first.
pub const SERVICE_UUID: u128 = 0x52454354_7a65_4e6f_9a68_424c45313030;

/// Bytes of service data.
pub const SIZE: usize = 10;

const VERSION: u8 = 1;
const PLAIN: u8 = 0b0001;

/// What a listening node tells everyone in range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Advertisement {
    /// Where it listens.
    pub psm: Psm,
    /// It takes plain one-batch-per-SDU links only, without a hello (a microcontroller).
    pub plain: bool,
    /// CRC-32 (IEEE) of the node's name: enough to pick it out; the hello confirms the whole name.
    pub name_hash: u32,
    /// Who belongs together; 0 where no fleet is set.
    pub fleet_hash: u16,
    /// Changes each time the listener starts, so that a restart can be told from a repetition.
    pub incarnation: u16,
}

/// Why service data is not an advertisement of ours.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum AdvertisementError {
    /// It has the wrong length.
    #[error("{0} bytes of service data, {SIZE} wanted")]
    Length(usize),
    /// It is of a version this program does not know.
    #[error("version {0} of the advertisement is not known here: update this program")]
    Version(u8),
    /// Its PSM is not one of LE's dynamic range.
    #[error("psm {0} is out of range")]
    Psm(u8),
}

impl Advertisement {
    /// The name's hash, as advertised.
    pub fn hash_of_name(name: &str) -> u32 {
        crc32fast::hash(name.as_bytes())
    }

    /// The fleet's hash, as advertised: 16 bits of the CRC-32 of its name, and never the 0 of no fleet.
    pub fn hash_of_fleet(fleet: &str) -> u16 {
        let hash = crc32fast::hash(fleet.as_bytes());
        ((hash >> 16) as u16 ^ hash as u16).max(1)
    }

    /// Whether it can be that node's.
    pub fn is_of(&self, name: &str) -> bool {
        self.name_hash == Self::hash_of_name(name)
    }

    /// The service data.
    pub fn encode(&self) -> [u8; SIZE] {
        let mut data = [0; SIZE];
        data[0] = VERSION << 4 | if self.plain { PLAIN } else { 0 };
        data[1] = self.psm.number() as u8;
        data[2..6].copy_from_slice(&self.name_hash.to_le_bytes());
        data[6..8].copy_from_slice(&self.fleet_hash.to_le_bytes());
        data[8..10].copy_from_slice(&self.incarnation.to_le_bytes());
        data
    }

    /// Reads service data. Unknown flags are ignored, so that later versions may add some.
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
    fn an_advertisement_reads_back_as_it_was_written() {
        for plain in [false, true] {
            let sent = Advertisement { plain, ..sample() };
            assert_eq!(Advertisement::decode(&sent.encode()), Ok(sent));
        }
    }

    #[test]
    fn every_length_but_ten_is_refused() {
        for length in (0..40).filter(|n| *n != SIZE) {
            let data = vec![0x10; length];
            assert_eq!(
                Advertisement::decode(&data),
                Err(AdvertisementError::Length(length))
            );
        }
    }

    #[test]
    fn another_version_and_a_low_psm_are_refused() {
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
    fn a_name_is_known_by_its_hash() {
        assert!(sample().is_of("wombat-2"));
        assert!(!sample().is_of("wombat-3"));
    }
}
