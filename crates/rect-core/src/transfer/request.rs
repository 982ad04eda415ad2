//! Encodes the requests of a receiver to a sender.
use std::ops::Range;

use super::{
    answer::Fault,
    wire::{write_number, Reader},
    MAX_PIECE_BYTES,
};

const RANGE: u8 = 0x10;
const ENDED: u8 = 0x11;
const CONFIRM: u8 = 0x12;

/// A request of a receiver to the sender of a transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Requests a piece. The reply consists of exactly these bytes, so that they can be stored without a copy.
    Range {
        /// Offset of the first byte.
        offset: u64,
        /// Number of bytes: 1 to [`MAX_PIECE_BYTES`].
        length: u32,
        /// Number of bytes that the receiver has, from which the sender derives the progress.
        received_bytes: u64,
    },
    /// Reports that the transfer has finished at the receiver. The sender then offers it once more, and the answer to
    /// that offer contains the outcome: on the receiver's own key, so that no other robot can end the transfer. The
    /// sender keeps this query open until it has the answer.
    Ended,
    /// Asks whether this robot offers the transfer. The reply is the encoded [`Offer`](super::Offer).
    Confirm,
}

impl Request {
    /// Encodes the request.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::Range {
                offset,
                length,
                received_bytes,
            } => {
                let mut out = vec![RANGE];
                write_number(&mut out, *offset);
                write_number(&mut out, u64::from(*length));
                write_number(&mut out, *received_bytes);
                out
            }
            Self::Ended => vec![ENDED],
            Self::Confirm => vec![CONFIRM],
        }
    }

    /// Decodes an untrusted request. Returns `None` if the bytes are not a request.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut reader = Reader(bytes);
        let request = match reader.byte()? {
            RANGE => {
                let offset = reader.number()?;
                let length = u32::try_from(reader.number()?).ok()?;
                if !(1..=MAX_PIECE_BYTES).contains(&length) {
                    return None;
                }
                offset.checked_add(u64::from(length))?;
                let received_bytes = reader.number()?;
                Self::Range {
                    offset,
                    length,
                    received_bytes,
                }
            }
            ENDED => Self::Ended,
            CONFIRM => Self::Confirm,
            _ => return None,
        };
        reader.end()?;
        Some(request)
    }

    /// Returns the requested range of a source of `size_bytes`.
    ///
    /// # Errors
    /// Returns [`Fault::Protocol`] if the range exceeds the source.
    pub fn range(offset: u64, length: u32, size_bytes: u64) -> Result<Range<u64>, Fault> {
        match offset.checked_add(u64::from(length)) {
            Some(end) if end <= size_bytes => Ok(offset..end),
            _ => {
                let text = format!("requested {length} bytes at {offset} of {size_bytes}");
                Err(Fault::Protocol(text))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_round_trip_and_truncated_ones_are_rejected() {
        let range = |offset, length| Request::Range {
            offset,
            length,
            received_bytes: 200,
        };
        let requests = [
            range(0, 1),
            range(1 << 40, MAX_PIECE_BYTES),
            range(u64::MAX - 1, 1),
            Request::Ended,
            Request::Confirm,
        ];
        for request in requests {
            let bytes = request.encode();
            assert_eq!(Request::decode(&bytes), Some(request));
            for cut in 0..bytes.len() {
                assert_eq!(Request::decode(&bytes[..cut]), None, "cut to {cut}");
            }
            assert_eq!(Request::decode(&[&bytes[..], &[0]].concat()), None);
        }
        for bad in [
            range(0, 0),
            range(0, MAX_PIECE_BYTES + 1),
            range(u64::MAX, 1),
        ] {
            assert_eq!(Request::decode(&bad.encode()), None, "{bad:?}");
        }
    }

    #[test]
    fn ranges_beyond_the_end_are_rejected() {
        assert_eq!(Request::range(4, 6, 10), Ok(4..10));
        for (offset, length) in [(5, 6), (10, 1), (u64::MAX, 1)] {
            assert!(matches!(
                Request::range(offset, length, 10),
                Err(Fault::Protocol(_))
            ));
        }
    }
}
