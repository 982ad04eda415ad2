//! Owns whole numbers of as many bytes as they need: LEB128, and zigzag for signed ones.

/// Appends it: 7 bits a byte, the lowest first.
pub fn write(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

/// Takes one off the front; `None`: it is cut off, or longer than 64 bits.
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

/// Small ones of either sign become small ones: 0, -1, 1, -2 become 0, 1, 2, 3.
pub fn zigzag(number: i64) -> u64 {
    (number << 1 ^ number >> 63) as u64
}

/// And back.
pub fn unzigzag(number: u64) -> i64 {
    (number >> 1) as i64 ^ -((number & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back() {
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
    fn what_is_longer_than_64_bits_is_none() {
        assert_eq!(read(&mut [0xff; 11].as_slice()), None);
        let mut two = [0xff; 10];
        two[9] = 2;
        assert_eq!(read(&mut two.as_slice()), None);
    }
}
