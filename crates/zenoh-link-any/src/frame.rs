//! Encodes and decodes the frames that travel on a path. For the layout see section 3 of `PROTOCOL.md`.
use link_lanes::lanes::{Lane, LANES};

const DATA: u8 = 0x10;
const DATA_LAZY: u8 = 0x11;
const ACK: u8 = 0x12;
const PING: u8 = 0x13;
const CLOSE: u8 = 0x14;
const OFFER: u8 = 0x15;
/// The bits of the first byte that contain the kind. The three others contain the lane. No message of Zenoh's transport has
/// bit 4 in its first byte's low five bits, so a frame is never taken for one.
const KIND: u8 = 0x1f;

/// Size of a data frame's head and offset, in bytes.
pub const DATA_HEAD_BYTES: usize = 4;
/// Number of bits of an offset that are sent.
pub const OFFSET_BITS: u32 = 24;

/// The content of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame<'a> {
    /// Bytes of a lane's stream.
    Data {
        /// The lane.
        lane: Lane,
        /// The lower [`OFFSET_BITS`] bits of the position of the first byte.
        offset: u32,
        /// Whether the receiver may delay its acknowledgement for seconds.
        is_lazy: bool,
        /// At least one byte.
        bytes: &'a [u8],
    },
    /// Which frames have arrived, and which lanes are stopped.
    Ack {
        /// Number of frames that have arrived on this path, modulo 2^16.
        frames: u16,
        /// Which lanes are stopped, as bits.
        stopped: u8,
        /// The number of the last change of `stopped`, modulo 2^8.
        change: u8,
    },
    /// Asks for an acknowledgement.
    Ping,
    /// Ends the link, with the code of the reason.
    Close(u8),
    /// Offers addresses for further paths: see [`offer`](crate::offer).
    Offer(&'a [u8]),
}

/// Why a frame was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The frame has a wrong length for its kind.
    #[error("a frame of {0} bytes, which is a wrong length for its kind")]
    Size(usize),
    /// The first byte is unknown.
    #[error("a frame of unknown kind {0:#04x}")]
    Head(u8),
}

impl Frame<'_> {
    /// Appends the encoded frame.
    pub fn encode(&self, to: &mut Vec<u8>) {
        match *self {
            Self::Data {
                lane,
                offset,
                is_lazy,
                bytes,
            } => {
                data_head(lane, offset, is_lazy, to);
                to.extend_from_slice(bytes);
            }
            Self::Ack {
                frames,
                stopped,
                change,
            } => {
                let [low, high] = frames.to_le_bytes();
                to.extend_from_slice(&[ACK, low, high, stopped, change]);
            }
            Self::Ping => to.push(PING),
            Self::Close(reason) => to.extend_from_slice(&[CLOSE, reason]),
            Self::Offer(body) => {
                to.push(OFFER);
                to.extend_from_slice(body);
            }
        }
    }
}

/// Appends the head and the offset of a data frame, whose bytes follow.
pub fn data_head(lane: Lane, offset: u32, is_lazy: bool, to: &mut Vec<u8>) {
    let kind = if is_lazy { DATA_LAZY } else { DATA };
    let [low, middle, high, _] = offset.to_le_bytes();
    to.extend_from_slice(&[lane.number() << 5 | kind, low, middle, high]);
}

/// Decodes a frame.
///
/// # Errors
/// Fails if the kind or the size is not one of the protocol.
pub fn decode(frame: &[u8]) -> Result<Frame<'_>, FrameError> {
    let [head, body @ ..] = frame else {
        return Err(FrameError::Size(frame.len()));
    };
    let (kind, lane) = (head & KIND, head >> 5);
    const { assert!(LANES == 8) };
    let lane = Lane::new(lane).ok_or(FrameError::Head(*head))?;
    if lane != Lane::first() && !matches!(kind, DATA | DATA_LAZY) {
        return Err(FrameError::Head(*head));
    }
    match (kind, body) {
        (DATA | DATA_LAZY, [low, middle, high, bytes @ ..]) if !bytes.is_empty() => {
            Ok(Frame::Data {
                lane,
                offset: u32::from_le_bytes([*low, *middle, *high, 0]),
                is_lazy: kind == DATA_LAZY,
                bytes,
            })
        }
        (ACK, [low, high, stopped, change]) => Ok(Frame::Ack {
            frames: u16::from_le_bytes([*low, *high]),
            stopped: *stopped,
            change: *change,
        }),
        (PING, []) => Ok(Frame::Ping),
        (CLOSE, [reason]) => Ok(Frame::Close(*reason)),
        (OFFER, body) => Ok(Frame::Offer(body)),
        (DATA | DATA_LAZY | ACK | PING | CLOSE, _) => Err(FrameError::Size(frame.len())),
        _ => Err(FrameError::Head(*head)),
    }
}

/// Returns the lower bits of a position in a stream.
pub fn truncated(position: u64) -> u32 {
    (position & (OFFSET_SPAN - 1)) as u32
}

const OFFSET_SPAN: u64 = 1 << OFFSET_BITS;

/// Returns the position with these lower bits that is nearest to `expected`, or `None` if it is before the beginning of the
/// stream.
pub fn nearest(offset: u32, expected: u64) -> Option<u64> {
    let distance = (u64::from(offset).wrapping_sub(expected)) & (OFFSET_SPAN - 1);
    if distance < OFFSET_SPAN / 2 {
        return Some(expected + distance);
    }
    (expected + distance).checked_sub(OFFSET_SPAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_survive_encoding() {
        let lane = |n| Lane::new(n).expect("valid");
        let data = |n, offset, is_lazy| Frame::Data {
            lane: lane(n),
            offset,
            is_lazy,
            bytes: b"bytes",
        };
        for frame in [
            data(0, 0, false),
            data(7, 0x00ff_ffff, true),
            data(5, 0x0001_0203, false),
            Frame::Ack {
                frames: 0x1234,
                stopped: 0b1010_0001,
                change: 255,
            },
            Frame::Ping,
            Frame::Close(3),
            Frame::Offer(b"addresses"),
        ] {
            let mut encoded = Vec::new();
            frame.encode(&mut encoded);
            assert_eq!(decode(&encoded), Ok(frame));
        }
    }

    #[test]
    fn malformed_frames_are_rejected() {
        assert_eq!(decode(&[]), Err(FrameError::Size(0)));
        assert_eq!(decode(&[DATA, 0, 0, 0]), Err(FrameError::Size(4)), "empty");
        assert_eq!(decode(&[ACK, 0, 0]), Err(FrameError::Size(3)));
        assert_eq!(decode(&[PING, 0]), Err(FrameError::Size(2)));
        assert_eq!(decode(&[CLOSE]), Err(FrameError::Size(1)));
        assert_eq!(
            decode(&[PING | 1 << 5]),
            Err(FrameError::Head(PING | 1 << 5))
        );
        for head in 0..=255 {
            if !(DATA..=OFFER).contains(&(head & KIND)) {
                assert_eq!(decode(&[head, 0, 0, 0, 0]), Err(FrameError::Head(head)));
            }
        }
    }

    #[test]
    fn positions_are_restored_from_their_lower_bits() {
        for expected in [0, 5, OFFSET_SPAN - 3, OFFSET_SPAN, 7 * OFFSET_SPAN + 9] {
            for distance in [0, 1, 500_000, OFFSET_SPAN / 2 - 1] {
                let later = expected + distance;
                assert_eq!(nearest(truncated(later), expected), Some(later));
                let earlier = expected.wrapping_sub(distance);
                let exists = (distance <= expected).then_some(earlier);
                assert_eq!(nearest(truncated(earlier), expected), exists);
            }
        }
    }
}
