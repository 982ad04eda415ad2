//! Handles the secret that the nodes of a team share, and derives from it what the handshake requires.
//!
//! `key_agreement` uses it. Section 3 of `PROTOCOL.md` specifies both.
use std::fmt;

use hmac::{Hmac, Mac};
use sha3::Sha3_256;

/// The shortest secret, in bytes. A peer that has dialled a robot once can try out secrets offline, so the secret has to be hard
/// to guess.
pub const MIN_SECRET: usize = 16;

/// A secret that a team shares. It is kept as the key of a hash and never printed.
#[derive(Clone)]
pub struct Secret(Hmac<Sha3_256>);

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
    }
}

impl Secret {
    /// Creates a secret from bytes. Returns `None` if there are fewer than [`MIN_SECRET`].
    pub fn new(secret: &[u8]) -> Option<Self> {
        let key = Some(secret).filter(|secret| secret.len() >= MIN_SECRET)?;
        Hmac::new_from_slice(key).ok().map(Self)
    }

    /// Derives the key that the handshake of two nodes with this secret requires.
    pub fn pre_shared_key(&self) -> [u8; 32] {
        let hash = self.0.clone().chain_update(b"RECT link 2 psk");
        hash.finalize().into_bytes().into()
    }

    /// Derives the passkey of six digits with which Bluetooth pairs the two sides if `sec=high`.
    pub fn passkey(&self) -> u32 {
        let hash = (self.0.clone().chain_update(b"passkey").finalize()).into_bytes();
        u32::from_le_bytes(std::array::from_fn(|at| hash[at])) % 1_000_000
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secret_is_not_printed_and_its_passkey_has_six_digits() {
        let secret = Secret::new(b"a secret of 16 bytes").expect("long enough");
        assert_eq!(format!("{secret:?}"), "Secret(..)");
        assert!(secret.passkey() < 1_000_000);
    }
}
