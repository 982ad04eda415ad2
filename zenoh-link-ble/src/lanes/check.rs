//! Owns the check of an SDU: two bytes that are right only if no SDU before it was lost, repeated or put out of order, and
//! no bit of it has changed.
//!
//! The number of the SDU goes into the check but not over the air: both sides count. Two bytes miss one fault in 65 536,
//! and a fault is rare to begin with: the radio's own CRC of 24 bits has passed the SDU. What is left is a kernel that
//! drops whole SDUs (Linux 5.10) and a serial line to the controller without a check of its own (Raspberry Pi).

/// Bytes of a check on the air.
pub const SIZE: usize = 2;
/// How far ahead a lost SDU is looked for, to tell a loss from damage.
const AHEAD: u32 = 1000;

/// Why a check is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// So many SDUs before this one never arrived.
    #[error("{0} sdus were lost on the way")]
    Lost(u32),
    /// The SDU is not what was sent, or was sent before.
    #[error("an sdu arrived damaged or twice")]
    Damaged,
}

/// The check of the SDU with that number.
pub fn of(number: u32, head: u8, body: &[u8]) -> [u8; SIZE] {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&number.to_le_bytes());
    hasher.update(&[head]);
    hasher.update(body);
    let crc = hasher.finalize();
    ((crc >> 16) as u16 ^ crc as u16).to_le_bytes()
}

/// Whether the SDU is the one with that number.
pub fn verify(number: u32, head: u8, check: [u8; SIZE], body: &[u8]) -> Result<(), Fault> {
    if of(number, head, body) == check {
        return Ok(());
    }
    let lost = (1..=AHEAD).find(|n| of(number.wrapping_add(*n), head, body) == check);
    Err(lost.map_or(Fault::Damaged, Fault::Lost))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_right_sdu_passes_and_a_gap_is_counted() {
        let check = of(70, 3, b"a batch");
        assert_eq!(verify(70, 3, check, b"a batch"), Ok(()));
        assert_eq!(verify(58, 3, check, b"a batch"), Err(Fault::Lost(12)));
        assert_eq!(verify(71, 3, check, b"a batch"), Err(Fault::Damaged));
    }

    #[test]
    fn every_changed_bit_is_found() {
        let mut body = *b"some batch of a few bytes";
        let check = of(9, 1, &body);
        for bit in 0..8 * body.len() {
            body[bit / 8] ^= 1 << (bit % 8);
            assert!(verify(9, 1, check, &body).is_err(), "bit {bit}");
            body[bit / 8] ^= 1 << (bit % 8);
        }
        assert!(verify(9, 2, check, &body).is_err(), "the lane");
    }
}
