//! Writes and reads numbers in LEB128: seven bits in each byte, the lowest first.

/// Writes a number, byte by byte.
pub(super) fn write(mut rest: u64, mut push: impl FnMut(u8)) {
    while rest >= 0x80 {
        push(rest as u8 | 0x80);
        rest >>= 7;
    }
    push(rest as u8);
}

/// Returns the number of at most `max_bytes` bytes, 9 at most, at the beginning of the bytes, and the bytes after it.
pub(super) fn read(mut bytes: &[u8], max_bytes: usize) -> Option<(u64, &[u8])> {
    let mut number = 0;
    for place in 0..max_bytes {
        let (&byte, after) = bytes.split_first()?;
        bytes = after;
        number |= u64::from(byte & 0x7f) << (7 * place);
        if byte & 0x80 == 0 {
            return Some((number, bytes));
        }
    }
    None
}
