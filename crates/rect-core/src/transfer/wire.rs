//! Encodes the numbers (LEB128) and texts (with their length) in a transfer's messages.

/// The bytes that are left to read. Each method returns `None` if there are too few bytes, or if they are invalid.
pub(super) struct Reader<'a>(pub(super) &'a [u8]);

impl<'a> Reader<'a> {
    pub(super) fn bytes(&mut self, length: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(bytes)
    }

    pub(super) fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }

    pub(super) fn byte(&mut self) -> Option<u8> {
        Some(self.array::<1>()?[0])
    }

    /// Reads a number in LEB128. Only the shortest form is accepted, so that each number has a single encoding.
    pub(super) fn number(&mut self) -> Option<u64> {
        let mut number = 0u64;
        for shift in (0..70).step_by(7) {
            let byte = self.byte()?;
            let bits = u64::from(byte & 0x7f);
            if shift == 63 && bits > 1 {
                return None;
            }
            number |= bits << shift;
            if byte & 0x80 == 0 {
                return (byte != 0 || shift == 0).then_some(number);
            }
        }
        None
    }

    /// Reads a text of at most `max_bytes`.
    pub(super) fn text(&mut self, max_bytes: usize) -> Option<&'a str> {
        let length = usize::try_from(self.number()?).ok()?;
        if length > max_bytes {
            return None;
        }
        std::str::from_utf8(self.bytes(length)?).ok()
    }

    /// Returns `None` unless everything was read.
    pub(super) fn end(&self) -> Option<()> {
        self.0.is_empty().then_some(())
    }
}

pub(super) fn write_number(out: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        out.push(number as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

pub(super) fn write_text(out: &mut Vec<u8>, text: &str) {
    write_number(out, text.len() as u64);
    out.extend_from_slice(text.as_bytes());
}

/// Returns the longest beginning of a text that fits `max_bytes`.
pub(super) fn cut(text: &str, max_bytes: usize) -> &str {
    let end = (0..=max_bytes.min(text.len())).rev();
    &text[..end
        .into_iter()
        .find(|&n| text.is_char_boundary(n))
        .unwrap_or(0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_a_single_encoding() {
        for number in [0, 1, 127, 128, 300, 1 << 32, u64::MAX - 1, u64::MAX] {
            let mut bytes = Vec::new();
            write_number(&mut bytes, number);
            let mut reader = Reader(&bytes);
            assert_eq!(reader.number(), Some(number));
            assert_eq!(reader.end(), Some(()));
            for cut in 0..bytes.len() {
                assert_eq!(
                    Reader(&bytes[..cut]).number(),
                    None,
                    "{number} cut to {cut}"
                );
            }
        }
        assert_eq!(Reader(&[0x80, 0]).number(), None, "0 in two bytes");
        let mut over = [0xff; 10];
        over[9] = 2;
        assert_eq!(Reader(&over).number(), None, "65 bits");
        assert_eq!(Reader(&[0xff; 11]).number(), None, "no end");
    }

    #[test]
    fn the_length_of_texts_is_limited() {
        let mut bytes = Vec::new();
        write_text(&mut bytes, "äö");
        assert_eq!(Reader(&bytes).text(4), Some("äö"));
        assert_eq!(Reader(&bytes).text(3), None);
        assert_eq!(Reader(&[2, 0xff, 0xff]).text(9), None, "not UTF-8");
        assert_eq!(Reader(&[0xff, 0xff, 3]).text(usize::MAX), None, "missing");
        assert_eq!((cut("äö", 3), cut("äö", 9), cut("äö", 0)), ("ä", "äö", ""));
    }
}
