//! Encodes what a router adds to a message that it sends to a throttled subscriber: 2 bytes, which precede the attachment of the message.
//!
//! | bytes | content |
//! |---|---|
//! | 1 | `0xF6`. No text in UTF-8 begins with such a byte, and no other attachment of RECT's |
//! | 1 | the number of the message in its stream, modulo 32; 32 more if its value is that of the one before; 64 more for the first message; 128 more if it repeats the one before |
//! | any | the attachment of the message, as its publisher has sent it |
const MARK: u8 = 0xF6;
const UNCHANGED: u8 = 32;
const FIRST: u8 = 64;
const REPEATS: u8 = 128;
/// The number of numbers.
const NUMBERS: u8 = 32;
/// The longest attachment that is passed on.
const MAX_ATTACHMENT: usize = 64;

/// The bytes that a router adds to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// The number of the message in its stream, modulo 32.
    pub number: u8,
    /// Whether its value is that of the message before it in the stream.
    pub is_unchanged: bool,
    /// Whether the stream begins with it.
    pub is_first: bool,
    /// Whether the message repeats the last one, for subscribers that have left that out.
    pub repeats: bool,
}

impl Header {
    /// Encodes the header, and the attachment of the message.
    pub fn encode(self, attachment: Option<&[u8]>) -> Vec<u8> {
        let flag = |is_set: bool, flag: u8| if is_set { flag } else { 0 };
        let flags = flag(self.is_unchanged, UNCHANGED)
            | flag(self.is_first, FIRST)
            | flag(self.repeats, REPEATS);
        let attachment = attachment.filter(|bytes| bytes.len() <= MAX_ATTACHMENT);
        let mut bytes = vec![MARK, (self.number % NUMBERS) | flags];
        bytes.extend_from_slice(attachment.unwrap_or_default());
        bytes
    }

    /// Decodes a header. Returns the attachment of the message, too.
    pub fn decode(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let [MARK, flags, attachment @ ..] = bytes else {
            return None;
        };
        let header = Self {
            number: flags % NUMBERS,
            is_unchanged: flags & UNCHANGED != 0,
            is_first: flags & FIRST != 0,
            repeats: flags & REPEATS != 0,
        };
        Some((header, attachment))
    }

    /// Returns how far the message is after the one with the number `last`; negative if it was sent before that.
    pub fn after(self, last: u32) -> i32 {
        let ahead = self.number.wrapping_sub(last as u8) % NUMBERS;
        match ahead < NUMBERS / 2 {
            true => ahead.into(),
            false => i32::from(ahead) - i32::from(NUMBERS),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_round_trip_in_two_bytes() {
        for (number, is_first, repeats) in [(0, true, false), (31, false, true), (5, false, false)]
        {
            let header = Header {
                number,
                is_unchanged: repeats,
                is_first,
                repeats,
            };
            let bytes = header.encode(Some(b"rest"));
            assert_eq!(bytes.len(), 6);
            assert_eq!(Header::decode(&bytes), Some((header, &b"rest"[..])));
            assert_eq!(header.encode(None).len(), 2);
            assert_eq!(header.encode(Some(&[0; 65])).len(), 2);
        }
        assert_eq!(Header::decode(b""), None);
        assert_eq!(Header::decode(&[MARK]), None);
        assert_eq!(Header::decode(&[0xF8, 1, 2, 3]), None);
    }

    #[test]
    fn numbers_are_compared_modulo_32() {
        let header = |number| Header {
            number,
            is_unchanged: false,
            is_first: false,
            repeats: false,
        };
        assert_eq!(header(1).after(31), 2);
        assert_eq!(header(31).after(64), -1);
        assert_eq!(header(5).after(32 * 1000 + 5), 0);
    }
}
