//! Computes and verifies the check of an SDU: two bytes that match only if no earlier SDU was lost, repeated or reordered,
//! and no bit of the SDU has changed.
//!
//! The check covers the number of the SDU, which is not sent: both sides count. Two bytes miss one fault in 65 536. Faults
//! are rare, because the SDU has already passed the radio's own CRC of 24 bits. The remaining causes are a kernel that drops
//! whole SDUs (Linux 5.10), and a serial line to the controller without a checksum (Raspberry Pi).

/// Size of a check, in bytes.
pub const SIZE: usize = 2;
/// How many lost SDUs are considered when a check does not match, to distinguish loss from damage.
const MAX_LOOKAHEAD: u32 = 1000;

/// Why a check does not match.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// The given number of SDUs before this one did not arrive.
    #[error("{0} sdus were lost on the way")]
    Lost(u32),
    /// The SDU was damaged, or has been received before.
    #[error("an sdu arrived damaged or twice")]
    Damaged,
}

/// Computes the check of the SDU with that number and content.
pub fn compute(number: u32, content: &[u8]) -> [u8; SIZE] {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&number.to_le_bytes());
    hasher.update(content);
    let crc = hasher.finalize();
    ((crc >> 16) as u16 ^ crc as u16).to_le_bytes()
}

/// Verifies that the SDU is undamaged and is the one with that number.
///
/// # Errors
/// Fails if the check does not match, with the most likely cause.
pub fn verify(number: u32, check: [u8; SIZE], content: &[u8]) -> Result<(), Fault> {
    if compute(number, content) == check {
        return Ok(());
    }
    let lost = (1..=MAX_LOOKAHEAD).find(|n| compute(number.wrapping_add(*n), content) == check);
    Err(lost.map_or(Fault::Damaged, Fault::Lost))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn right_sdu_passes_and_lost_ones_are_counted() {
        let check = compute(70, b"a batch");
        assert_eq!(verify(70, check, b"a batch"), Ok(()));
        assert_eq!(verify(58, check, b"a batch"), Err(Fault::Lost(12)));
        assert_eq!(verify(71, check, b"a batch"), Err(Fault::Damaged));
    }

    #[test]
    fn every_changed_bit_is_detected() {
        let mut body = *b"some batch of a few bytes";
        let check = compute(9, &body);
        for bit in 0..8 * body.len() {
            body[bit / 8] ^= 1 << (bit % 8);
            assert!(verify(9, check, &body).is_err(), "bit {bit}");
            body[bit / 8] ^= 1 << (bit % 8);
        }
    }
}
