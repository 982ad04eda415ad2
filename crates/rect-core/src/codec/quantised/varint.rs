//! Encodes whole numbers in as few bytes as possible: LEB128, with zigzag for signed numbers.

/// Appends a number, 7 bits per byte, the lowest bits first.
pub fn write(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

/// Reads a number and advances the slice. `None` if it is truncated or has more than 64 bits.
pub fn read(bytes: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..70).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        if shift == 63 && byte > 1 {
            return None;
        }
        number |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(number);
        }
    }
    None
}

/// Maps signed to unsigned numbers such that small ones stay small: 0, -1, 1, -2 become 0, 1, 2, 3.
pub fn zigzag(number: i64) -> u64 {
    (number << 1 ^ number >> 63) as u64
}

/// Reverts [`zigzag`].
pub fn unzigzag(number: u64) -> i64 {
    (number >> 1) as i64 ^ -((number & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_round_trip() {
        for number in [0, 1, -1, 63, -64, 64, i64::MAX, i64::MIN] {
            let mut bytes = Vec::new();
            write(&mut bytes, zigzag(number));
            let mut rest = bytes.as_slice();
            assert_eq!(read(&mut rest).map(unzigzag), Some(number));
            assert!(rest.is_empty());
            assert_eq!(read(&mut &bytes[..bytes.len() - 1]), None, "cut");
        }
    }

    #[test]
    fn numbers_of_more_than_64_bits_are_rejected() {
        assert_eq!(read(&mut [0xff; 11].as_slice()), None);
        let mut two = [0xff; 10];
        two[9] = 2;
        assert_eq!(read(&mut two.as_slice()), None);
    }
}
