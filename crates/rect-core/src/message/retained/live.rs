//! Encodes the attachment of a retained message that is published: what its keeper and its program say about it, in 18 to 34 bytes.
//!
//! | bytes | content |
//! |---|---|
//! | 1 | `0xF7`. No text in UTF-8 begins with such a byte, and no other attachment of RECT's |
//! | 1 | the urgency: 0 normal, 1 urgent, 2 bulk; 16 more if the message repeats one of a recording |
//! | 4 | the run of the router that keeps it, little endian |
//! | 1 to 9 | its number there, LEB128 |
//! | 4 | the run of the program that published it, little endian |
//! | 1 to 9 | how many values that run had published before, LEB128 |
//! | 6 | the time of sending in milliseconds since 1970 by the program's clock, little endian; of the message of the recording, if it repeats one |
use super::{Origin, Position};
use crate::message::{attachment::Sent, leb128, urgency::Urgency};

const MARK: u8 = 0xF7;
const REPLAYED: u8 = 16;
/// The maximum length of a number: 63 bits.
const NUMBER_BYTES: usize = 9;

/// Returns whether an attachment is that of a retained message.
pub fn is_live(attachment: &[u8]) -> bool {
    attachment.first() == Some(&MARK)
}

/// The attachment of a retained message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Live {
    /// The place of the value in the order of its keeper.
    pub position: Position,
    /// The identity of the value.
    pub origin: Origin,
    /// The time of sending in milliseconds since 1970, 48 bits; that of the message of a recording, if it repeats one.
    pub sent: Sent,
    /// The urgency of the message. A large one travels as bulk.
    pub urgency: Urgency,
}

impl Live {
    /// Encodes the attachment.
    pub fn encode(&self) -> Vec<u8> {
        let urgency = match self.urgency {
            Urgency::Normal => 0,
            Urgency::Urgent => 1,
            Urgency::Bulk => 2,
        };
        let replayed = if self.sent.is_replayed() { REPLAYED } else { 0 };
        let mut bytes = vec![MARK, urgency | replayed];
        for (run, number) in [
            (self.position.0, self.position.1),
            (self.origin.0, self.origin.1),
        ] {
            bytes.extend(run.to_le_bytes());
            leb128::write(number, |byte| bytes.push(byte));
        }
        bytes.extend(&self.sent.ms().unwrap_or(0).to_le_bytes()[..6]);
        bytes
    }

    /// Decodes an attachment. Returns `None` if the bytes are something else.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (&urgency, rest) = bytes.strip_prefix(&[MARK])?.split_first()?;
        let is_replayed = urgency & REPLAYED != 0;
        let urgency = match urgency & !REPLAYED {
            0 => Urgency::Normal,
            1 => Urgency::Urgent,
            2 => Urgency::Bulk,
            _ => return None,
        };
        let (run, rest) = rest.split_first_chunk()?;
        let (number, rest) = leb128::read(rest, NUMBER_BYTES)?;
        let (program, rest) = rest.split_first_chunk()?;
        let (count, rest) = leb128::read(rest, NUMBER_BYTES)?;
        let low: [u8; 6] = rest.try_into().ok()?;
        let mut sent = [0; 8];
        sent[..6].copy_from_slice(&low);
        Some(Self {
            position: Position(u32::from_le_bytes(*run), number),
            origin: Origin(u32::from_le_bytes(*program), count),
            sent: match is_replayed {
                true => Sent::Replayed(u64::from_le_bytes(sent)),
                false => Sent::At(u64::from_le_bytes(sent)),
            },
            urgency,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::attachment::Attachment;

    #[test]
    fn attachments_round_trip() {
        for (number, bytes) in [(0, 18), (127, 18), (128, 19), ((1 << 63) - 1, 26)] {
            let live = Live {
                position: Position(7, number),
                origin: Origin(u32::MAX, 1),
                sent: match bytes % 2 {
                    0 => Sent::At((1 << 48) - 1),
                    _ => Sent::Replayed((1 << 48) - 1),
                },
                urgency: Urgency::Bulk,
            };
            let encoded = live.encode();
            assert_eq!(encoded.len(), bytes);
            assert_eq!(Live::decode(&encoded), Some(live));
            assert_eq!(Attachment::decode(&encoded), None, "another attachment");
            for cut in 0..bytes {
                assert_eq!(Live::decode(&encoded[..cut]), None, "cut to {cut}");
            }
            assert_eq!(Live::decode(&[&encoded[..], &[0]].concat()), None);
        }
    }
}
