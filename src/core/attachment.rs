//! Encodes the attachment of a message: 4 to 14 bytes of metadata beside the payload.
//!
//! | bytes | content |
//! |---|---|
//! | 1 | `0xF8` plus three flag bits, the third of which is reserved. No text in UTF-8 begins with such a byte, so attachments of other Zenoh programs are not mistaken for RECT's |
//! | 2 | the source: a random number that each publisher chooses when it starts, little endian |
//! | 1 to 5 | the sequence number of the message at that source, LEB128 |
//! | 6 | with flag 1: the time of sending in milliseconds since 1970 by the sender's clock, little endian |
//! | 2 | with flag 2 instead: the low 16 bits of that time; for frames of a stream, of which only the age matters |

const MARK: u8 = 0xF8;
const TIME: u8 = 1;
const SHORT_TIME: u8 = 2;

/// The maximum length of an attachment, in bytes.
pub const MAX_BYTES: usize = 14;

/// The time at which a message was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// The attachment contains no time.
    Unknown,
    /// Milliseconds since 1970 by the sender's clock; 48 bits.
    At(u64),
    /// The low 16 bits of the same number.
    Low(u16),
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
}

impl Attachment {
    /// Encodes the attachment.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(MAX_BYTES);
        bytes.push(match self.sent {
            Sent::Unknown => MARK,
            Sent::At(_) => MARK | TIME,
            Sent::Low(_) => MARK | SHORT_TIME,
        });
        bytes.extend_from_slice(&self.source.to_le_bytes());
        let mut rest = self.sequence;
        while rest >= 0x80 {
            bytes.push(rest as u8 | 0x80);
            rest >>= 7;
        }
        bytes.push(rest as u8);
        match self.sent {
            Sent::Unknown => {}
            Sent::At(at_ms) => bytes.extend_from_slice(&at_ms.to_le_bytes()[..6]),
            Sent::Low(low) => bytes.extend_from_slice(&low.to_le_bytes()),
        }
        bytes
    }

    /// Decodes an attachment. Returns `None` if the bytes are something else, such as the attachment of another Zenoh
    /// program.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (&flags, rest) = bytes.split_first()?;
        let (source, mut rest) = rest.split_first_chunk()?;
        let mut sequence = 0u64;
        for shift in (0..35).step_by(7) {
            let (&byte, after) = rest.split_first()?;
            rest = after;
            sequence |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                let sent = match flags ^ MARK {
                    0 if rest.is_empty() => Sent::Unknown,
                    TIME => {
                        let low: [u8; 6] = rest.try_into().ok()?;
                        let mut all = [0; 8];
                        all[..6].copy_from_slice(&low);
                        Sent::At(u64::from_le_bytes(all))
                    }
                    SHORT_TIME => Sent::Low(u16::from_le_bytes(rest.try_into().ok()?)),
                    _ => return None,
                };
                return Some(Self {
                    source: u16::from_le_bytes(*source),
                    sequence: u32::try_from(sequence).ok()?,
                    sent,
                });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attachments_round_trip_in_few_bytes() {
        let cases = [
            (0, Sent::Unknown, 4),
            (127, Sent::Low(65535), 6),
            (128, Sent::At(1_795_000_000_000), 11),
            (u32::MAX, Sent::At((1 << 48) - 1), 14),
        ];
        for (sequence, sent, bytes) in cases {
            let attachment = Attachment {
                source: 0xABCD,
                sequence,
                sent,
            };
            let encoded = attachment.encode();
            assert_eq!(encoded.len(), bytes, "{attachment:?}");
            assert_eq!(Attachment::decode(&encoded), Some(attachment));
            for cut in 0..bytes {
                assert_eq!(Attachment::decode(&encoded[..cut]), None, "cut to {cut}");
            }
            let longer = [encoded.as_slice(), &[0]].concat();
            assert_eq!(Attachment::decode(&longer), None, "one byte too many");
        }
    }

    #[test]
    fn attachments_of_other_programs_are_rejected() {
        for other in ["", "text", "{\"a\":1}", "ÿþ", "日本"] {
            assert_eq!(Attachment::decode(other.as_bytes()), None, "{other}");
        }
        assert_eq!(
            Attachment::decode(&[MARK | 4, 0, 0, 0]),
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
