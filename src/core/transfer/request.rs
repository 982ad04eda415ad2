//! Owns the request: what a receiver asks of a sender.
use std::ops::Range;

use super::{
    answer::Fault,
    wire::{write_number, Reader},
    MAX_PIECE_BYTES,
};

const RANGE: u8 = 0x10;
const ENDED: u8 = 0x11;
const CONFIRM: u8 = 0x12;

/// What a receiver asks of a sender, or tells it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// These bytes. The reply has exactly them and nothing else, so that they go to where they belong without a copy.
    Range {
        /// Where they begin.
        offset: u64,
        /// How many: 1 to [`MAX_PIECE_BYTES`].
        length: u32,
        /// How many bytes the receiver holds: the sender's progress.
        held_bytes: u64,
    },
    /// The transfer is over at the receiver. The sender offers once more, and the answer to that offer says how it ended: on
    /// the receiver's own key, so that nobody else can end it. The sender keeps this query open until it has the answer.
    Ended,
    /// Asks whether this robot offers the transfer. The reply is the encoded [`Offer`](super::Offer).
    Confirm,
}

impl Request {
    /// As bytes.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::Range {
                offset,
                length,
                held_bytes,
            } => {
                let mut out = vec![RANGE];
                write_number(&mut out, *offset);
                write_number(&mut out, u64::from(*length));
                write_number(&mut out, *held_bytes);
                out
            }
            Self::Ended => vec![ENDED],
            Self::Confirm => vec![CONFIRM],
        }
    }

    /// From bytes that anyone may have sent; `None`: they are no request.
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
                let held_bytes = reader.number()?;
                Self::Range {
                    offset,
                    length,
                    held_bytes,
                }
            }
            ENDED => Self::Ended,
            CONFIRM => Self::Confirm,
            _ => return None,
        };
        reader.end()?;
        Some(request)
    }

    /// The bytes that are asked for, of so many that there are.
    ///
    /// # Errors
    /// [`Fault::Protocol`]: there are fewer.
    pub fn range(offset: u64, length: u32, size_bytes: u64) -> Result<Range<u64>, Fault> {
        match offset.checked_add(u64::from(length)) {
            Some(end) if end <= size_bytes => Ok(offset..end),
            _ => {
                let text = format!("asked for {length} bytes at {offset} of {size_bytes}");
                Err(Fault::Protocol(text))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_comes_back_as_it_was_and_no_part_of_it_does() {
        let range = |offset, length| Request::Range {
            offset,
            length,
            held_bytes: 200,
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
    fn a_range_beyond_the_end_is_not_answered() {
        assert_eq!(Request::range(4, 6, 10), Ok(4..10));
        for (offset, length) in [(5, 6), (10, 1), (u64::MAX, 1)] {
            assert!(matches!(
                Request::range(offset, length, 10),
                Err(Fault::Protocol(_))
            ));
        }
    }
}
