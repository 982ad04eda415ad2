//! Encodes and decodes the SDUs of an open link: head, body and trailer. The trailer is a check, or with a secret a tag, and
//! then the body is encrypted. For the layout see section 4 of `PROTOCOL.md`.
use super::{
    check::{self, Fault},
    Lane,
};
use crate::seal::{LinkKeys, NotAuthentic, OpeningKey, SealingKey, TAG_BYTES};

const BATCH: u8 = 0;
const ACK: u8 = 1;
const STOP: u8 = 2;
const GO: u8 = 3;
const GOODBYE: u8 = 4;
const INTERVAL: u8 = 5;

/// Size of the head of an SDU, in bytes.
pub const HEAD_BYTES: usize = 1;

/// The content of an SDU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content<'a> {
    /// One Zenoh batch, never empty.
    Batch(Lane, &'a [u8]),
    /// The total cost of the batches that the receiver has read from its socket since the link began, in bytes modulo
    /// 2^16: see `credits`.
    Ack(u16),
    /// The receiver holds enough of that lane. The sender sends no more of it until [`Content::Go`].
    Stop(Lane),
    /// The receiver accepts more of that lane.
    Go(Lane),
    /// The end of the link, with the code of the reason.
    Goodbye(u8),
    /// A connection interval in units of 1.25 ms: from the central, the one that it has set; from the peripheral, a request.
    Interval(u16),
}

/// Why an SDU was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SduError {
    /// The SDU has a wrong length for its kind.
    #[error("an sdu of {0} bytes, which is a wrong length for its kind")]
    Size(usize),
    /// The kind or the lane in the first byte is unknown.
    #[error("an sdu of unknown kind {0:#04x}")]
    Head(u8),
    /// The check does not match.
    #[error(transparent)]
    Fault(#[from] Fault),
    /// The peer has not sealed this SDU as its next one.
    #[error(transparent)]
    NotAuthentic(#[from] NotAuthentic),
}

impl SduError {
    /// Returns whether the cause may be the path to the peer, and not the peer.
    pub fn is_of_path(self) -> bool {
        matches!(self, Self::Fault(_) | Self::NotAuthentic(_))
    }
}

impl Content<'_> {
    /// Encodes the head and the body.
    pub fn encode(&self) -> Vec<u8> {
        let with_body = |kind: u8, lane: u8, body: &[u8]| {
            let mut sdu = Vec::with_capacity(HEAD_BYTES + body.len());
            sdu.push(kind << 4 | lane);
            sdu.extend_from_slice(body);
            sdu
        };
        match self {
            Self::Batch(lane, batch) => with_body(BATCH, lane.number(), batch),
            Self::Ack(total) => with_body(ACK, 0, &total.to_le_bytes()),
            Self::Stop(lane) => with_body(STOP, lane.number(), &[]),
            Self::Go(lane) => with_body(GO, lane.number(), &[]),
            Self::Goodbye(reason) => with_body(GOODBYE, 0, &[*reason]),
            Self::Interval(units) => with_body(INTERVAL, 0, &units.to_le_bytes()),
        }
    }
}

/// Decodes a head and a body whose trailer was verified.
///
/// # Errors
/// Fails if the kind, the lane or the size is not one of the protocol.
pub fn decode(sdu: &[u8]) -> Result<Content<'_>, SduError> {
    let [head, body @ ..] = sdu else {
        return Err(SduError::Size(sdu.len()));
    };
    let lane = Lane::new(head & 0x0f).ok_or(SduError::Head(*head))?;
    let kind = head >> 4;
    if matches!(kind, ACK | GOODBYE | INTERVAL) && lane.number() != 0 {
        return Err(SduError::Head(*head));
    }
    match (kind, body) {
        (BATCH, [_, ..]) => Ok(Content::Batch(lane, body)),
        (ACK, [low, high]) => Ok(Content::Ack(u16::from_le_bytes([*low, *high]))),
        (STOP, []) => Ok(Content::Stop(lane)),
        (GO, []) => Ok(Content::Go(lane)),
        (GOODBYE, [reason]) => Ok(Content::Goodbye(*reason)),
        (INTERVAL, [low, high]) => Ok(Content::Interval(u16::from_le_bytes([*low, *high]))),
        (BATCH | ACK | STOP | GO | GOODBYE | INTERVAL, _) => Err(SduError::Size(sdu.len())),
        _ => Err(SduError::Head(*head)),
    }
}

/// Protects the SDUs of a link in both directions.
#[derive(Debug)]
pub struct Protection {
    /// For the SDUs of this side.
    pub out: Sealer,
    /// For the SDUs of the peer.
    pub into: Opener,
}

impl Protection {
    /// Returns the protection of a link without a secret: checks against faults, which protect against nobody.
    pub fn checks() -> Self {
        Self {
            out: Sealer::Check { number: 0 },
            into: Opener::Check { number: 0 },
        }
    }

    /// Returns the protection of a link with a secret.
    pub fn keys(keys: LinkKeys) -> Self {
        Self {
            out: Sealer::Key(keys.sealing),
            into: Opener::Key(keys.opening),
        }
    }

    /// Returns whether SDUs are encrypted.
    pub fn is_encrypted(&self) -> bool {
        matches!(self.out, Sealer::Key(_))
    }

    /// Returns the number of bytes that an SDU has in addition to its batch.
    pub fn overhead(&self) -> usize {
        overhead(self.is_encrypted())
    }
}

/// Returns the number of bytes that an SDU of a link has in addition to its batch.
pub fn overhead(is_encrypted: bool) -> usize {
    HEAD_BYTES
        + match is_encrypted {
            true => TAG_BYTES,
            false => check::SIZE,
        }
}

/// Appends the trailers to the SDUs of this side.
#[derive(Debug)]
pub enum Sealer {
    /// Checks; `number` is the number of SDUs that were sent before.
    Check {
        /// Number of SDUs that were sent.
        number: u32,
    },
    /// Encryption and tags.
    Key(SealingKey),
}

impl Sealer {
    /// Seals the next SDU in place and gives it to `send`. If `send` returns `Ok(false)`, the SDU was not sent at all, and
    /// another one may take its place.
    ///
    /// # Errors
    /// Those of `send`.
    pub fn seal<E>(
        &mut self,
        sdu: &mut Vec<u8>,
        send: impl FnOnce(&[u8]) -> Result<bool, E>,
    ) -> Result<bool, E> {
        match self {
            Self::Check { number } => {
                let check = check::compute(*number, sdu);
                sdu.extend_from_slice(&check);
                let is_sent = send(sdu)?;
                if is_sent {
                    *number = number.wrapping_add(1);
                }
                Ok(is_sent)
            }
            Self::Key(key) => key.seal(sdu, send),
        }
    }

    /// Returns the number of bytes that an SDU has in addition to its batch.
    pub fn overhead(&self) -> usize {
        overhead(matches!(self, Self::Key(_)))
    }
}

/// Verifies the trailers of the peer's SDUs.
#[derive(Debug)]
pub enum Opener {
    /// Checks; `number` is the number of SDUs that were received before.
    Check {
        /// Number of SDUs that were received.
        number: u32,
    },
    /// Decryption and tags.
    Key(OpeningKey),
}

impl Opener {
    /// Verifies and decodes the next SDU, and decrypts it in place.
    ///
    /// # Errors
    /// Fails if the trailer does not match, or if the kind, the lane or the size is not one of the protocol.
    pub fn open<'a>(&mut self, sdu: &'a mut [u8]) -> Result<Content<'a>, SduError> {
        match self {
            Self::Check { number } => {
                let size = sdu.len();
                let Some((content, &check)) = sdu.split_last_chunk() else {
                    return Err(SduError::Size(size));
                };
                if content.is_empty() {
                    return Err(SduError::Size(size));
                }
                check::verify(*number, check, content)?;
                *number = number.wrapping_add(1);
                decode(content)
            }
            Self::Key(key) => decode(key.open(sdu)?),
        }
    }

    /// Returns the number of bytes that an SDU has in addition to its batch.
    pub fn overhead(&self) -> usize {
        overhead(matches!(self, Self::Key(_)))
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    /// Returns the protection of both ends of a link, without and with a secret.
    fn pairs() -> [(Protection, Protection); 2] {
        let keys = |own, of_peer| Protection::keys(LinkKeys::new([own; 32], [of_peer; 32]));
        [
            (Protection::checks(), Protection::checks()),
            (keys(1, 2), keys(2, 1)),
        ]
    }

    fn sealed(sealer: &mut Sealer, mut sdu: Vec<u8>) -> Vec<u8> {
        let Ok(_) = sealer.seal(&mut sdu, |_| Ok::<_, Infallible>(true));
        sdu
    }

    #[test]
    fn every_sdu_decodes_to_what_was_encoded() {
        let lane = Lane::new(5).expect("valid");
        for (mut one, mut other) in pairs() {
            for content in [
                Content::Batch(lane, b"x"),
                Content::Ack(4711),
                Content::Stop(lane),
                Content::Go(lane),
                Content::Goodbye(3),
                Content::Interval(24),
            ] {
                let encoded = content.encode();
                let mut sdu = sealed(&mut one.out, encoded.clone());
                assert_eq!(sdu.len(), encoded.len() - HEAD_BYTES + one.overhead());
                assert_eq!(other.into.open(&mut sdu), Ok(content));
            }
        }
    }

    #[test]
    fn malformed_sdu_is_rejected() {
        for (sdu, error) in [
            (vec![], SduError::Size(0)),
            (vec![0x05], SduError::Size(1)),
            (vec![0x10, 1], SduError::Size(2)),
            (vec![0x15, 1, 1], SduError::Head(0x15)),
            (vec![0x25, 1], SduError::Size(2)),
            (vec![0x41, 1], SduError::Head(0x41)),
            (vec![0x08, 1], SduError::Head(0x08)),
            (vec![0x50, 1], SduError::Size(2)),
            (vec![0x60, 1], SduError::Head(0x60)),
        ] {
            assert_eq!(decode(&sdu), Err(error));
        }
        for (_, mut other) in pairs() {
            for length in 0..other.overhead() {
                assert!(other.into.open(&mut vec![0; length]).is_err(), "{length}");
            }
        }
    }

    #[test]
    fn lost_sdu_is_detected() {
        let batch = || Content::Batch(Lane::first(), b"x").encode();
        let errors = [SduError::Fault(Fault::Lost(3)), NotAuthentic.into()];
        for ((mut one, mut other), error) in pairs().into_iter().zip(errors) {
            assert!(other.into.open(&mut sealed(&mut one.out, batch())).is_ok());
            (0..3).for_each(|_| drop(sealed(&mut one.out, batch())));
            let mut later = sealed(&mut one.out, batch());
            assert_eq!(other.into.open(&mut later), Err(error));
        }
    }
}
