//! Encodes the feedback that a receiver sends to a stream's sender, by default twice per second, in at most
//! [`MAX_BYTES`] bytes.
//!
//! | bytes | content |
//! |---|---|
//! | 1 | upper half: version 1; flag 1: the slow group; flag 2: the pace is present; flag 4: video is decoded here; flag 8: the video needs a key frame |
//! | 2 | the receiver: a random number that it chooses when it starts, little endian; 0: a recorder, which only asks for a key frame |
//! | 2 | the source of the received frames, little endian |
//! | 1 to 5 each | LEB128: the sequence number of the last frame; then, since the previous feedback: milliseconds, frames, bytes, frames skipped, and the 90th percentile of the age in milliseconds |
//! | 1 to 5 | with flag 2: the pace in bytes per second, LEB128 |
use super::Group;

/// The maximum length of feedback, in bytes.
pub const MAX_BYTES: usize = 40;

/// The receiver's number in the request of a recorder, whose pace does not matter to the stream.
pub const RECORDER: u16 = 0;

const VERSION: u8 = 1 << 4;
const SLOW: u8 = 1;
const PACE: u8 = 2;
const VIDEO: u8 = 4;
const KEY: u8 = 8;

/// A receiver's report about the frames that arrived.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Feedback {
    /// Group of the receiver.
    pub group: Group,
    /// Number that distinguishes the receivers of a robot.
    pub receiver: u16,
    /// Source of the frames. 0 before the first frame.
    pub source: u16,
    /// Sequence number of the newest frame.
    pub last: u32,
    /// Time span that the report covers, in milliseconds.
    pub span_ms: u32,
    /// Frames that arrived.
    pub frames: u32,
    /// Bytes of these frames.
    pub bytes: u32,
    /// Frames that did not arrive.
    pub skipped: u32,
    /// 90th percentile of the age of the frames on arrival, in milliseconds.
    pub age_ms: u32,
    /// Pace at which the frames arrived, in bytes per second. `None` if the offset of the clocks is unknown,
    /// or if all frames were too small to measure it.
    pub pace_bytes_per_s: Option<u32>,
    /// Whether the receiver decodes video.
    pub accepts_video: bool,
    /// Whether the receiver can decode nothing until there is a key frame.
    pub needs_key: bool,
}

/// The bytes are not valid feedback.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FeedbackError {
    /// The feedback has an unsupported version, or the bytes are something else.
    #[error(
        "feedback of the kind {0:#04x} is not supported: the receiver uses another version of RECT"
    )]
    Version(u8),
    /// The feedback is truncated or too long, or contains a number that is out of range.
    #[error("invalid feedback")]
    Damaged,
}

impl Feedback {
    /// Returns the request of a recorder for a key frame.
    pub fn of_recorder() -> Self {
        Self {
            receiver: RECORDER,
            accepts_video: true,
            needs_key: true,
            ..Self::default()
        }
    }

    /// Encodes the feedback.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(MAX_BYTES);
        let flags = [
            (self.group == Group::Slow, SLOW),
            (self.pace_bytes_per_s.is_some(), PACE),
            (self.accepts_video, VIDEO),
            (self.needs_key, KEY),
        ];
        let set = flags.into_iter().filter(|(is_set, _)| *is_set);
        bytes.push(set.fold(VERSION, |kind, (_, flag)| kind | flag));
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

    /// Decodes untrusted feedback.
    ///
    /// # Errors
    /// Returns a [`FeedbackError`] if the bytes are not valid feedback.
    pub fn decode(bytes: &[u8]) -> Result<Self, FeedbackError> {
        let (&kind, rest) = bytes.split_first().ok_or(FeedbackError::Damaged)?;
        if kind & !(SLOW | PACE | VIDEO | KEY) != VERSION {
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
            accepts_video: kind & VIDEO != 0,
            needs_key: kind & KEY != 0,
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

    fn typical() -> Feedback {
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
            accepts_video: true,
            needs_key: true,
        }
    }

    #[test]
    fn feedback_round_trips_in_few_bytes() {
        let all = u32::MAX;
        let longest = Feedback {
            last: all,
            span_ms: all,
            frames: all,
            bytes: all,
            skipped: all,
            age_ms: all,
            pace_bytes_per_s: Some(all),
            ..typical()
        };
        for (feedback, size) in [
            (typical(), 18),
            (Feedback::default(), 11),
            (longest, MAX_BYTES),
        ] {
            let bytes = feedback.encode();
            assert_eq!(bytes.len(), size, "{feedback:?}");
            assert_eq!(Feedback::decode(&bytes), Ok(feedback));
        }
    }

    #[test]
    fn invalid_feedback_is_rejected() {
        let bytes = typical().encode();
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
