//! Encodes the attachment of a message: 4 to 19 bytes of metadata beside the payload.
//!
//! | bytes | content |
//! |---|---|
//! | 1 | `0xF8` plus three flag bits. No text in UTF-8 begins with such a byte, so attachments of other Zenoh programs are not mistaken for RECT's |
//! | 2 | the source: a random number that each publisher chooses when it starts, little endian |
//! | 1 to 5 | the sequence number of the message at that source, LEB128 |
//! | 6 | with flag 1: the time of sending in milliseconds since 1970 by the sender's clock, little endian |
//! | 6 | with flags 1 and 2: the same time of the message of a recording that this one repeats |
//! | 2 | with flag 2 alone: the low 16 bits of that time; for frames of a stream, of which only the age matters |
//! | 1 to 5 | with flag 4: the time in milliseconds after which the message expires, LEB128 |
use std::{
    ops::Deref,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use serde::{Deserialize, Serialize};

use super::leb128;

const MARK: u8 = 0xF8;
const TIME: u8 = 1;
const SHORT_TIME: u8 = 2;
const RECORDED_TIME: u8 = TIME | SHORT_TIME;
const LIFETIME: u8 = 4;

/// The maximum length of an attachment, in bytes.
pub const MAX_BYTES: usize = 19;

/// An encoded attachment.
#[derive(Clone, Copy, Debug, Default)]
pub struct Encoded {
    bytes: [u8; MAX_BYTES],
    length: usize,
}

/// The time at which a message was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Sent {
    /// The attachment contains no time.
    Unknown,
    /// Milliseconds since 1970 by the sender's clock; 48 bits.
    At(u64),
    /// The low 16 bits of the same number.
    Low(u16),
    /// The message repeats one of a recording, which was sent at this time: milliseconds since 1970, 48 bits.
    Replayed(u64),
}

impl Sent {
    /// Returns the whole time. `None` if the attachment does not contain it.
    pub(crate) fn at(self) -> Option<SystemTime> {
        UNIX_EPOCH.checked_add(Duration::from_millis(self.ms()?))
    }

    /// Returns the whole time in milliseconds since 1970. `None` if the attachment does not contain it.
    pub(crate) fn ms(self) -> Option<u64> {
        match self {
            Self::At(at_ms) | Self::Replayed(at_ms) => Some(at_ms),
            Self::Low(_) | Self::Unknown => None,
        }
    }

    /// Returns whether the message repeats one of a recording.
    pub(crate) fn is_replayed(self) -> bool {
        matches!(self, Self::Replayed(_))
    }
}

/// The metadata that is sent with the payload of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// The source: a random number that identifies one run of a publisher. Two programs of a robot may publish the same
    /// topic, and a program may be restarted.
    pub source: u16,
    /// The sequence number of the message at its source, modulo 2^32.
    pub sequence: u32,
    /// The time at which the message was sent.
    pub sent: Sent,
    /// The time in milliseconds after which the message expires. `None`: it never does.
    pub lifetime_ms: Option<u32>,
}

impl Attachment {
    /// Encodes the attachment.
    pub fn encode(&self) -> Encoded {
        let mut bytes = Encoded::default();
        let time = match self.sent {
            Sent::Unknown => 0,
            Sent::At(_) => TIME,
            Sent::Low(_) => SHORT_TIME,
            Sent::Replayed(_) => RECORDED_TIME,
        };
        let lifetime = self.lifetime_ms.map_or(0, |_| LIFETIME);
        bytes.push(MARK | time | lifetime);
        bytes.extend(self.source.to_le_bytes());
        leb128::write(self.sequence.into(), |byte| bytes.push(byte));
        match self.sent {
            Sent::Unknown => {}
            Sent::At(at_ms) | Sent::Replayed(at_ms) => {
                let [a, b, c, d, e, f, ..] = at_ms.to_le_bytes();
                bytes.extend([a, b, c, d, e, f]);
            }
            Sent::Low(low) => bytes.extend(low.to_le_bytes()),
        }
        if let Some(lifetime_ms) = self.lifetime_ms {
            leb128::write(lifetime_ms.into(), |byte| bytes.push(byte));
        }
        bytes
    }

    /// Decodes an attachment. Returns `None` if the bytes are something else, such as the attachment of another Zenoh
    /// program.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (&flags, rest) = bytes.split_first()?;
        let (source, rest) = rest.split_first_chunk()?;
        let (sequence, rest) = read_number(rest)?;
        let flags = flags ^ MARK;
        let (sent, rest) = match flags & !LIFETIME {
            0 => (Sent::Unknown, rest),
            time @ (TIME | RECORDED_TIME) => {
                let (low, rest) = rest.split_first_chunk::<6>()?;
                let mut all = [0; 8];
                all[..6].copy_from_slice(low);
                let at_ms = u64::from_le_bytes(all);
                let sent = match time {
                    TIME => Sent::At(at_ms),
                    _ => Sent::Replayed(at_ms),
                };
                (sent, rest)
            }
            SHORT_TIME => {
                let (low, rest) = rest.split_first_chunk()?;
                (Sent::Low(u16::from_le_bytes(*low)), rest)
            }
            _ => return None,
        };
        let (lifetime_ms, rest) = match flags & LIFETIME {
            0 => (None, rest),
            _ => read_number(rest).map(|(lifetime_ms, rest)| (Some(lifetime_ms), rest))?,
        };
        rest.is_empty().then_some(Self {
            source: u16::from_le_bytes(*source),
            sequence,
            sent,
            lifetime_ms,
        })
    }
}

impl Encoded {
    fn push(&mut self, byte: u8) {
        self.extend([byte]);
    }

    /// Appends bytes, of which an attachment never has more than [`MAX_BYTES`].
    fn extend<const N: usize>(&mut self, more: [u8; N]) {
        let end = self.length + N;
        self.bytes[self.length..end].copy_from_slice(&more);
        self.length = end;
    }
}

impl Deref for Encoded {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// Returns the number of 32 bits at the beginning of the bytes, and the bytes after it.
fn read_number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = leb128::read(bytes, 5)?;
    Some((u32::try_from(number).ok()?, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attachments_round_trip_in_few_bytes() {
        let cases = [
            (0, Sent::Unknown, None, 4),
            (127, Sent::Low(65535), None, 6),
            (128, Sent::At(1_795_000_000_000), None, 11),
            (5, Sent::At(1_795_000_000_000), Some(100), 11),
            (5, Sent::Replayed(1_795_000_000_000), None, 10),
            (u32::MAX, Sent::At((1 << 48) - 1), Some(u32::MAX), MAX_BYTES),
        ];
        for (sequence, sent, lifetime_ms, bytes) in cases {
            let attachment = Attachment {
                source: 0xABCD,
                sequence,
                sent,
                lifetime_ms,
            };
            let encoded = attachment.encode();
            assert_eq!(encoded.len(), bytes, "{attachment:?}");
            assert_eq!(Attachment::decode(&encoded), Some(attachment));
            for cut in 0..bytes {
                assert_eq!(Attachment::decode(&encoded[..cut]), None, "cut to {cut}");
            }
            let longer = [&encoded[..], &[0]].concat();
            assert_eq!(Attachment::decode(&longer), None, "one byte too many");
        }
    }

    #[test]
    fn attachments_of_other_programs_are_rejected() {
        for other in ["", "text", "{\"a\":1}", "ÿþ", "日本"] {
            assert_eq!(Attachment::decode(other.as_bytes()), None, "{other}");
        }
        assert_eq!(
            Attachment::decode(&[MARK | TIME | SHORT_TIME, 0, 0, 0]),
            None,
            "a later version"
        );
        assert_eq!(
            Attachment::decode(&[MARK, 0, 0, 255, 255, 255, 255, 127]),
            None,
            "33 bits"
        );
    }
}
