//! Owns what a receiver tells a stream's sender, twice a second, in at most [`MAX_BYTES`].
//!
//! | bytes | what |
//! |---|---|
//! | 1 | version 1 in the upper half; flag 1: of the slow group; flag 2: the pace is there |
//! | 2 | the receiver: a number that it draws when it starts, little endian |
//! | 2 | the source of the frames that it hears, little endian |
//! | each 1 to 5 | LEB128: the last frame's number; and since the last such message: milliseconds, frames, bytes, frames skipped, the age in milliseconds that 9 of 10 frames stay below |
//! | 1 to 5 | with flag 2: the pace, bytes per second, LEB128 |
use super::Group;

/// The longest, in bytes.
pub const MAX_BYTES: usize = 40;

const VERSION: u8 = 1 << 4;
const SLOW: u8 = 1;
const PACE: u8 = 2;

/// What a receiver says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Feedback {
    /// Where it listens.
    pub group: Group,
    /// Which of the programs of its robot it is.
    pub receiver: u16,
    /// The source of the frames; 0 before there was one.
    pub source: u16,
    /// The number of the newest.
    pub last: u32,
    /// What the rest is about, in milliseconds.
    pub span_ms: u32,
    /// Frames that came.
    pub frames: u32,
    /// Their bytes.
    pub bytes: u32,
    /// Frames that did not.
    pub skipped: u32,
    /// 9 of 10 were not older, in milliseconds.
    pub age_ms: u32,
    /// Bytes per second at which frames came through: three of four were not slower. `None`: the clocks are not known.
    pub pace_bytes_per_s: Option<u32>,
}

/// It is no such message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FeedbackError {
    /// Another version of it, or something else.
    #[error("feedback of the kind {0:#04x} is not known here: the receiver is of another version")]
    Version(u8),
    /// Cut off, too long, or a number out of range.
    #[error("this is no valid feedback")]
    Damaged,
}

impl Feedback {
    /// As bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(MAX_BYTES);
        let slow = if self.group == Group::Slow { SLOW } else { 0 };
        let pace = if self.pace_bytes_per_s.is_some() {
            PACE
        } else {
            0
        };
        bytes.push(VERSION | slow | pace);
        bytes.extend_from_slice(&self.receiver.to_le_bytes());
        bytes.extend_from_slice(&self.source.to_le_bytes());
        let numbers = [
            self.last,
            self.span_ms,
            self.frames,
            self.bytes,
            self.skipped,
            self.age_ms,
        ];
        for number in numbers.into_iter().chain(self.pace_bytes_per_s) {
            push(&mut bytes, number);
        }
        bytes
    }

    /// From bytes of whoever sent them.
    ///
    /// # Errors
    /// They are something else.
    pub fn decode(bytes: &[u8]) -> Result<Self, FeedbackError> {
        let (&kind, rest) = bytes.split_first().ok_or(FeedbackError::Damaged)?;
        if kind & !(SLOW | PACE) != VERSION {
            return Err(FeedbackError::Version(kind));
        }
        let (&[r0, r1, s0, s1], mut rest) =
            rest.split_first_chunk().ok_or(FeedbackError::Damaged)?;
        let mut next = || take(&mut rest).ok_or(FeedbackError::Damaged);
        let feedback = Self {
            group: if kind & SLOW == 0 {
                Group::Main
            } else {
                Group::Slow
            },
            receiver: u16::from_le_bytes([r0, r1]),
            source: u16::from_le_bytes([s0, s1]),
            last: next()?,
            span_ms: next()?,
            frames: next()?,
            bytes: next()?,
            skipped: next()?,
            age_ms: next()?,
            pace_bytes_per_s: if kind & PACE == 0 {
                None
            } else {
                Some(next()?)
            },
        };
        if rest.is_empty() {
            Ok(feedback)
        } else {
            Err(FeedbackError::Damaged)
        }
    }
}

fn push(bytes: &mut Vec<u8>, mut number: u32) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

fn take(bytes: &mut &[u8]) -> Option<u32> {
    let mut number = 0u64;
    for shift in (0..35).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        number |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return u32::try_from(number).ok();
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn usual() -> Feedback {
        Feedback {
            group: Group::Slow,
            receiver: 0xABCD,
            source: 0x1234,
            last: 4711,
            span_ms: 503,
            frames: 4,
            bytes: 15_000,
            skipped: 1,
            age_ms: 190,
            pace_bytes_per_s: Some(33_500),
        }
    }

    #[test]
    fn it_comes_back_and_is_a_few_bytes() {
        let all = u32::MAX;
        let most = Feedback {
            last: all,
            span_ms: all,
            frames: all,
            bytes: all,
            skipped: all,
            age_ms: all,
            pace_bytes_per_s: Some(all),
            ..usual()
        };
        for (feedback, size) in [(usual(), 18), (Feedback::default(), 11), (most, MAX_BYTES)] {
            let bytes = feedback.encode();
            assert_eq!(bytes.len(), size, "{feedback:?}");
            assert_eq!(Feedback::decode(&bytes), Ok(feedback));
        }
    }

    #[test]
    fn what_is_cut_off_longer_or_of_another_version_is_refused() {
        let bytes = usual().encode();
        for cut in 0..bytes.len() {
            assert_eq!(
                Feedback::decode(&bytes[..cut]),
                Err(FeedbackError::Damaged),
                "cut to {cut}"
            );
        }
        let longer = [bytes.as_slice(), &[0]].concat();
        assert_eq!(Feedback::decode(&longer), Err(FeedbackError::Damaged));
        assert_eq!(
            Feedback::decode(b"hello"),
            Err(FeedbackError::Version(b'h'))
        );
        let mut endless = bytes[..5].to_vec();
        endless.extend([0xff; 6]);
        assert_eq!(Feedback::decode(&endless), Err(FeedbackError::Damaged));
    }
}
