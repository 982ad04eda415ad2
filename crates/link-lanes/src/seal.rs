//! Encrypts and authenticates the SDUs of a link with a secret: AES-128-CCM with a tag of 8 bytes, and one key for each
//! direction. For the rules see section 3 of `PROTOCOL.md`.
//!
//! Two SDUs must never be encrypted with the same key and number. A [`SealingKey`] therefore owns its number and cannot be
//! cloned, and it shows the encrypted bytes only to the function that sends them.
use std::fmt;

use aes::Aes128;
use ccm::{
    aead::{generic_array::GenericArray, AeadInPlace, KeyInit},
    consts::{U13, U8},
    Ccm,
};
use hmac::{Hmac, Mac};
use sha3::Sha3_256;

/// Size of a tag, in bytes.
pub const TAG_BYTES: usize = 8;
/// Number of SDUs after which each direction changes to its next key.
pub const SDUS_PER_KEY: u64 = 1 << 20;

type Cipher = Ccm<Aes128, U8, U13>;
/// A key or another value of 32 bytes that is derived from the key agreement.
pub type Derived = [u8; 32];

/// The SDU was not sealed by the peer with this number: it is damaged, repeated, reordered or forged, or one before it was
/// lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an sdu could not be authenticated: it was damaged, lost, repeated or forged")]
pub struct NotAuthentic;

/// Derives a value from another one. The label separates the uses.
pub fn derive(from: &[u8], label: &[u8]) -> Derived {
    let hmac = <Hmac<Sha3_256> as Mac>::new_from_slice(from)
        .unwrap_or_else(|_| unreachable!("a key of any length is valid for HMAC"));
    hmac.chain_update(label).finalize().into_bytes().into()
}

/// The key of one direction, and the number of the next SDU.
struct Key {
    /// The value from which this key and the next one are derived.
    chain: Derived,
    cipher: Box<Cipher>,
    number: u64,
}

impl Key {
    fn new(chain: Derived) -> Self {
        Self {
            chain,
            cipher: cipher(&chain),
            number: 0,
        }
    }

    /// Returns the nonce of the next SDU: its number, followed by zeros.
    fn nonce(&self) -> GenericArray<u8, U13> {
        let mut nonce = GenericArray::default();
        nonce[..8].copy_from_slice(&self.number.to_le_bytes());
        nonce
    }

    /// Advances to the next SDU, and to the next key if it is due.
    fn advance(&mut self) {
        self.number += 1;
        if self.number % SDUS_PER_KEY == 0 {
            self.chain = derive(&self.chain, b"next");
            self.cipher = cipher(&self.chain);
        }
    }
}

fn cipher(chain: &Derived) -> Box<Cipher> {
    let key = derive(chain, b"key");
    let mut half = GenericArray::default();
    half.copy_from_slice(&key[..16]);
    Box::new(Cipher::new(&half))
}

/// The key with which this side seals.
#[derive(Debug)]
pub struct SealingKey {
    key: Key,
    /// The last SDU that was sealed and not sent, before and after sealing. The channel often has no room at first, and sealing
    /// the same SDU again for each attempt would waste processor time.
    unsent: Option<(Vec<u8>, Vec<u8>)>,
}

/// The key with which this side opens what the peer has sealed.
#[derive(Debug)]
pub struct OpeningKey(Key);

/// The keys of both directions of a link.
#[derive(Debug)]
pub struct LinkKeys {
    /// For the SDUs of this side.
    pub sealing: SealingKey,
    /// For the SDUs of the peer.
    pub opening: OpeningKey,
}

impl LinkKeys {
    /// Creates the keys from the chains of the two directions.
    pub fn new(own: Derived, of_peer: Derived) -> Self {
        Self {
            sealing: SealingKey {
                key: Key::new(own),
                unsent: None,
            },
            opening: OpeningKey(Key::new(of_peer)),
        }
    }
}

impl SealingKey {
    /// Seals the next SDU in place: encrypts all after its first byte, which is authenticated, and appends the tag. Then gives
    /// it to `send`. If `send` returns `Ok(false)`, the SDU was not sent at all, and its number is used for the next one.
    ///
    /// # Errors
    /// Those of `send`. The number counts as used.
    pub fn seal<E>(
        &mut self,
        sdu: &mut Vec<u8>,
        send: impl FnOnce(&[u8]) -> Result<bool, E>,
    ) -> Result<bool, E> {
        let unsent = self.unsent.take().filter(|(plain, _)| plain == sdu);
        let sealed = unsent.map(|(_, sealed)| sealed);
        let Some(sealed) = sealed.or_else(|| self.sealed(sdu)) else {
            return Ok(false);
        };
        let plain = std::mem::replace(sdu, sealed);
        let sent = send(sdu);
        match sent {
            Ok(false) => self.unsent = Some((plain, sdu.clone())),
            _ => self.key.advance(),
        }
        sent
    }

    /// Returns the SDU, sealed under the next number. `None` for an empty SDU, or a body of 64 kB, which no SDU has.
    fn sealed(&self, sdu: &[u8]) -> Option<Vec<u8>> {
        let mut sealed = Vec::with_capacity(sdu.len() + TAG_BYTES);
        sealed.extend_from_slice(sdu);
        let (head, body) = sealed.split_first_mut()?;
        let (cipher, nonce) = (&self.key.cipher, self.key.nonce());
        let tag = cipher.encrypt_in_place_detached(&nonce, &[*head], body);
        sealed.extend_from_slice(&tag.ok()?);
        Some(sealed)
    }
}

impl OpeningKey {
    /// Opens the next SDU of the peer in place, and returns it without its tag.
    ///
    /// # Errors
    /// Fails if the peer has not sealed these bytes as its next SDU.
    pub fn open<'a>(&mut self, sdu: &'a mut [u8]) -> Result<&'a [u8], NotAuthentic> {
        let length = sdu.len().checked_sub(TAG_BYTES).ok_or(NotAuthentic)?;
        let (sealed, tag) = sdu.split_at_mut(length);
        let (head, body) = sealed.split_first_mut().ok_or(NotAuthentic)?;
        let tag = GenericArray::from_slice(tag);
        (self.0.cipher)
            .decrypt_in_place_detached(&self.0.nonce(), &[*head], body, tag)
            .map_err(|_| NotAuthentic)?;
        self.0.advance();
        Ok(sealed)
    }
}

/// Keys are never printed.
impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Key {{ number: {}, .. }}", self.number)
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn pair() -> (LinkKeys, LinkKeys) {
        let (one, other) = ([1; 32], [2; 32]);
        (LinkKeys::new(one, other), LinkKeys::new(other, one))
    }

    fn seal(keys: &mut LinkKeys, sdu: &[u8]) -> Vec<u8> {
        let (mut buffer, mut sealed) = (sdu.to_vec(), Vec::new());
        let sent = keys.sealing.seal(&mut buffer, |bytes| {
            sealed = bytes.to_vec();
            Ok::<_, Infallible>(true)
        });
        assert_eq!(sent, Ok(true));
        sealed
    }

    fn open(keys: &mut LinkKeys, sealed: &[u8]) -> Result<Vec<u8>, NotAuthentic> {
        let mut buffer = sealed.to_vec();
        keys.opening.open(&mut buffer).map(<[u8]>::to_vec)
    }

    #[test]
    fn sealed_sdus_open_in_order_on_the_other_side_only() {
        let (mut one, mut other) = pair();
        for text in [&b"\x05one"[..], b"\x10", b"\x03three"] {
            let sealed = seal(&mut one, text);
            assert_eq!(sealed.len(), text.len() + TAG_BYTES);
            assert_eq!(sealed[0], text[0], "the first byte stays readable");
            assert!(text.len() < 4 || sealed[1..4] != text[1..4]);
            assert_eq!(open(&mut one, &sealed), Err(NotAuthentic), "reflected");
            assert_eq!(open(&mut other, &sealed).as_deref(), Ok(text));
            assert_eq!(open(&mut other, &sealed), Err(NotAuthentic), "repeated");
        }
        let (lost, next) = (seal(&mut one, b"\x00lost"), seal(&mut one, b"\x00next"));
        assert_eq!(open(&mut other, &next), Err(NotAuthentic));
        assert!(open(&mut other, &lost).is_ok());
        assert!(open(&mut other, &next).is_ok());
    }

    #[test]
    fn every_changed_bit_and_every_other_length_is_rejected() {
        let (mut one, mut other) = pair();
        let sealed = seal(&mut one, b"\x25some batch of a few bytes");
        for bit in 0..8 * sealed.len() {
            let mut changed = sealed.clone();
            changed[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(open(&mut other, &changed), Err(NotAuthentic), "bit {bit}");
        }
        for length in 0..sealed.len() {
            assert!(open(&mut other, &sealed[..length]).is_err(), "{length}");
        }
        assert!(open(&mut other, &[&sealed[..], &[0]].concat()).is_err());
        assert!(open(&mut other, &sealed).is_ok());
    }

    #[test]
    fn sdu_that_was_not_sent_is_replaced_under_its_number() {
        let (mut one, mut other) = pair();
        let mut refused = b"\x05bulk".to_vec();
        let sent = one
            .sealing
            .seal(&mut refused, |_| Ok::<_, Infallible>(false));
        assert_eq!(sent, Ok(false));
        // A second attempt shows the same bytes.
        let (before, mut again) = (refused, b"\x05bulk".to_vec());
        let sent = one.sealing.seal(&mut again, |bytes| {
            assert_eq!(bytes, before);
            Ok::<_, Infallible>(false)
        });
        assert_eq!(sent, Ok(false));
        let sealed = seal(&mut one, b"\x01urgent");
        assert_eq!(open(&mut other, &sealed).as_deref(), Ok(&b"\x01urgent"[..]));
        // After an error it is not known what was sent.
        let mut failed = b"\x05bulk".to_vec();
        assert_eq!(one.sealing.seal(&mut failed, |_| Err("down")), Err("down"));
        let sealed = seal(&mut one, b"\x01next");
        assert_eq!(open(&mut other, &sealed), Err(NotAuthentic));
    }

    #[test]
    fn keys_change_after_a_number_of_sdus_on_both_sides() {
        let (mut one, mut other) = pair();
        let before = one.sealing.key.chain;
        for key in [&mut one.sealing.key, &mut other.opening.0] {
            key.number = SDUS_PER_KEY - 1;
        }
        for text in [b"\x00last", b"\x00next"] {
            let sealed = seal(&mut one, text);
            assert_eq!(open(&mut other, &sealed).as_deref(), Ok(&text[..]));
        }
        assert_ne!(one.sealing.key.chain, before);
    }
}
