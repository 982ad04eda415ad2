//! Encodes the record that a receiver stores beside a part file, so that the transfer continues after a restart.
//!
//! A record consists of `RECTPART`, a version, the offer (preceded by its length), the received ranges (their count,
//! then for each the distance from the end of the previous range, and its length), and four bytes of SHA-256 of all
//! that, because a computer may lose power while the record is written.
use sha2::{Digest, Sha256};

use super::{
    offer::{self, Offer},
    ranges::Ranges,
    wire::{write_number, Reader},
};

const MARK: &[u8; 8] = b"RECTPART";
const VERSION: u8 = 1;
/// The maximum number of ranges in a record. There are few, because pieces are requested in order. If there are more,
/// the last ones are requested again.
const MAX_RANGES: usize = 1024;
/// The maximum length of a record, in bytes.
pub const MAX_BYTES: usize = 32 * 1024;

/// The state of a part file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// Offer of the transfer.
    pub offer: Offer,
    /// Ranges that the part file contains.
    pub held: Ranges,
}

impl Record {
    /// Encodes the record.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = MARK.to_vec();
        out.push(VERSION);
        let offer = self.offer.encode();
        write_number(&mut out, offer.len() as u64);
        out.extend_from_slice(&offer);
        write_number(&mut out, self.held.count().min(MAX_RANGES) as u64);
        let mut last = 0;
        for range in self.held.iter().take(MAX_RANGES) {
            write_number(&mut out, range.start - last);
            write_number(&mut out, range.end - range.start);
            last = range.end;
        }
        let check = check(&out);
        out.extend_from_slice(&check);
        out
    }

    /// Decodes a record. Returns `None` if it is damaged or something else; then the transfer begins anew.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        if bytes.len() > MAX_BYTES {
            return None;
        }
        let (content, found) = bytes.split_last_chunk()?;
        if check(content) != *found {
            return None;
        }
        let mut reader = Reader(content);
        if reader.array()? != *MARK || reader.byte()? != VERSION {
            return None;
        }
        let length = usize::try_from(reader.number()?).ok()?;
        if length > offer::MAX_BYTES {
            return None;
        }
        let offer = Offer::decode(reader.bytes(length)?).ok()?;
        let count = reader.number()?;
        if count > MAX_RANGES as u64 {
            return None;
        }
        let mut held = Ranges::default();
        let mut last = 0u64;
        for n in 0..count {
            let (gap, length) = (reader.number()?, reader.number()?);
            if length == 0 || (n > 0 && gap == 0) {
                return None;
            }
            let start = last.checked_add(gap)?;
            last = start.checked_add(length)?;
            if last > offer.size_bytes {
                return None;
            }
            held.insert(start..last);
        }
        reader.end()?;
        Some(Self { offer, held })
    }
}

fn check(bytes: &[u8]) -> [u8; 4] {
    let hash: [u8; 32] = Sha256::digest(bytes).into();
    hash.first_chunk().copied().unwrap_or_default()
}

/// Appends a valid check to any bytes, for fuzzing.
pub fn seal(bytes: &[u8]) -> Vec<u8> {
    [bytes, &check(bytes)].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::offer::sample;

    #[test]
    fn records_round_trip_and_damaged_ones_are_rejected() {
        let mut held = Ranges::default();
        for ranges in [
            &[][..],
            &[0..1000, 2000..2001],
            &[5..10, 4096..8192, 9999..10_000],
        ] {
            ranges.iter().cloned().for_each(|range| held.insert(range));
            let record = Record {
                offer: sample(10_000),
                held: held.clone(),
            };
            let bytes = record.encode();
            assert_eq!(Record::decode(&bytes), Some(record));
            for cut in 0..bytes.len() {
                assert_eq!(Record::decode(&bytes[..cut]), None, "cut to {cut}");
                let mut damaged = bytes.clone();
                damaged[cut] ^= 4;
                assert_eq!(Record::decode(&damaged), None, "damaged at {cut}");
            }
        }
    }

    #[test]
    fn invalid_ranges_are_rejected() {
        let record = |ranges: &[u8]| {
            let whole = Record {
                offer: sample(100),
                held: Ranges::default(),
            }
            .encode();
            let mut bytes = whole[..whole.len() - 5].to_vec();
            bytes.extend_from_slice(ranges);
            Record::decode(&seal(&bytes))
        };
        assert!(record(&[1, 0, 100]).is_some(), "all");
        assert!(record(&[2, 0, 50, 1, 49]).is_some(), "all but one");
        assert!(record(&[1, 1, 100]).is_none(), "beyond the end");
        assert!(record(&[1, 0, 0]).is_none(), "an empty one");
        assert!(record(&[2, 0, 5, 0, 5]).is_none(), "two adjacent ones");
        assert!(record(&[2, 0, 5]).is_none(), "one is missing");
        assert!(record(&[0xff, 0xff, 0xff, 0x7f]).is_none(), "too many");
    }

    #[test]
    fn keeps_the_first_of_too_many_ranges() {
        let mut held = Ranges::default();
        (0..5000).for_each(|n| held.insert(n * 1_000_000..n * 1_000_000 + 500_000));
        let bytes = Record {
            offer: sample(u64::MAX),
            held,
        }
        .encode();
        assert!(bytes.len() <= MAX_BYTES, "{}", bytes.len());
        let read = Record::decode(&bytes).expect("a record");
        assert_eq!(read.held.count(), MAX_RANGES);
    }
}
