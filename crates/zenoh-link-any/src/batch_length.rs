//! The length of a batch in a lane's stream: one byte below 128, otherwise two.

/// The largest length.
pub const MAX: usize = 0x7fff;

/// Appends a length, which is at most [`MAX`].
pub fn encode(length: usize, to: &mut Vec<u8>) {
    debug_assert!(length <= MAX);
    match length {
        0..0x80 => to.push(length as u8),
        _ => to.extend_from_slice(&[0x80 | (length >> 8) as u8, length as u8]),
    }
}

/// Decodes the length at the beginning of `bytes`, and returns it with the number of its bytes. Returns `None` if bytes are
/// missing.
pub fn decode(bytes: &[u8]) -> Option<(usize, usize)> {
    match *bytes {
        [short, ..] if short < 0x80 => Some((usize::from(short), 1)),
        [high, low, ..] => Some((usize::from(high & 0x7f) << 8 | usize::from(low), 2)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_survive_encoding() {
        for length in 0..=MAX {
            let mut bytes = Vec::new();
            encode(length, &mut bytes);
            let size = if length < 128 { 1 } else { 2 };
            assert_eq!(decode(&bytes), Some((length, size)));
            assert_eq!(decode(&bytes[..size - 1]), None);
        }
    }
}
