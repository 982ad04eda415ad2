//! Limits the size of the messages that a viewer sends over its WebSocket.

/// The largest message, in bytes: a request to show some ten thousand topics.
const MAX_MESSAGE: u64 = 1 << 20;

/// The frames of a WebSocket, of which only the lengths are read.
#[derive(Default)]
pub struct Frames {
    /// The bytes of a header that is not complete.
    header: Vec<u8>,
    /// The bytes of the frame that follow.
    remaining: u64,
    /// The bytes of the message so far.
    message: u64,
}

/// A message is larger than the limit.
#[derive(Debug, thiserror::Error)]
#[error("a message has more than {MAX_MESSAGE} bytes")]
pub struct TooLarge;

/// The header of a frame.
struct Header {
    is_last: bool,
    is_control: bool,
    length: u64,
}

impl Frames {
    /// Follows the next bytes.
    ///
    /// # Errors
    /// Fails if a message is larger than the limit.
    pub fn on_bytes(&mut self, mut bytes: &[u8]) -> Result<(), TooLarge> {
        loop {
            let skipped = bytes
                .len()
                .min(usize::try_from(self.remaining).unwrap_or(usize::MAX));
            self.remaining -= skipped as u64;
            let Some((first, rest)) = bytes[skipped..].split_first() else {
                return Ok(());
            };
            bytes = rest;
            self.header.push(*first);
            let Some(header) = Header::parse(&self.header) else {
                continue;
            };
            self.header.clear();
            self.remaining = header.length;
            // A control frame may be between the frames of a message.
            let before = if header.is_control { 0 } else { self.message };
            let message = before.saturating_add(header.length);
            if message > MAX_MESSAGE {
                return Err(TooLarge);
            }
            if !header.is_control {
                self.message = if header.is_last { 0 } else { message };
            }
        }
    }
}

impl Header {
    /// Parses a header. Returns `None` if it is not complete.
    fn parse(bytes: &[u8]) -> Option<Self> {
        let [first, second, rest @ ..] = bytes else {
            return None;
        };
        let short = second & 0x7f;
        let (length, mask) = match short {
            126 => rest
                .split_first_chunk()
                .map(|(length, rest)| (u16::from_be_bytes(*length).into(), rest))?,
            127 => rest
                .split_first_chunk()
                .map(|(length, rest)| (u64::from_be_bytes(*length), rest))?,
            _ => (short.into(), rest),
        };
        let has_mask = second & 0x80 != 0;
        let is_complete = !has_mask || mask.len() == 4;
        is_complete.then_some(Self {
            is_last: first & 0x80 != 0,
            is_control: first & 0x08 != 0,
            length,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: u8 = 1;
    const CONTINUED: u8 = 0;
    const PING: u8 = 9;

    /// Returns a frame with a mask.
    fn frame(kind: u8, is_last: bool, length: usize) -> Vec<u8> {
        let mut bytes = vec![kind | u8::from(is_last) << 7];
        match length {
            0..=125 => bytes.push(0x80 | length as u8),
            126..=0xffff => {
                bytes.push(0x80 | 126);
                bytes.extend((length as u16).to_be_bytes());
            }
            _ => {
                bytes.push(0x80 | 127);
                bytes.extend((length as u64).to_be_bytes());
            }
        }
        bytes.extend([0; 4]);
        bytes.extend(vec![0xff; length]);
        bytes
    }

    /// Follows the bytes in parts of each size.
    fn is_accepted(bytes: &[u8]) -> bool {
        let accepted = [1, 7, 4096, usize::MAX].map(|size| {
            let mut frames = Frames::default();
            let mut parts = bytes.chunks(size.min(bytes.len()));
            parts.all(|part| frames.on_bytes(part).is_ok())
        });
        assert!(
            accepted.iter().all(|one| *one == accepted[0]),
            "{accepted:?}"
        );
        accepted[0]
    }

    #[test]
    fn messages_up_to_the_limit_are_accepted() {
        let max = MAX_MESSAGE as usize;
        let all: Vec<u8> = [0, 1, 125, 126, 0xffff, 0x1_0000, max, 5]
            .into_iter()
            .flat_map(|length| frame(TEXT, true, length))
            .collect();
        assert!(is_accepted(&all));
        assert!(!is_accepted(&frame(TEXT, true, max + 1)));
    }

    #[test]
    fn the_parts_of_a_message_count_together() {
        let half = MAX_MESSAGE as usize / 2;
        let begun = [frame(TEXT, false, half), frame(PING, true, 100)].concat();
        assert!(is_accepted(
            &[
                &begun[..],
                &frame(CONTINUED, true, half),
                &frame(TEXT, true, half)
            ]
            .concat()
        ));
        assert!(!is_accepted(
            &[&begun[..], &frame(CONTINUED, false, half + 1)].concat()
        ));
    }

    #[test]
    fn a_length_beyond_all_limits_is_rejected() {
        let mut header = frame(TEXT, false, 0x1_0000)[..14].to_vec();
        header[2..10].fill(0xff);
        assert!(!is_accepted(&[frame(TEXT, false, 100), header].concat()));
    }
}
