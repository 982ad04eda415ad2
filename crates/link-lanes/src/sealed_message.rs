//! Messages of the handshake after the two sides have agreed on keys. For the layout see section 3 of `PROTOCOL.md`.
use std::convert::Infallible;

use super::{
    hello::{HandshakeMessage, HandshakeMessageError},
    seal::{LinkKeys, NotAuthentic},
};

/// The head of a sealed message of the handshake. No SDU of an open link has it.
const HEAD: u8 = 0xf0;

/// Why a sealed message was rejected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SealedMessageError {
    /// The peer has not sealed these bytes as its next SDU.
    #[error(transparent)]
    NotAuthentic(#[from] NotAuthentic),
    /// The SDU is one of an open link.
    #[error("it sent data before its hello")]
    Data,
    /// The sealed bytes are not a message of the handshake.
    #[error(transparent)]
    Message(#[from] HandshakeMessageError),
}

/// Encodes and seals a message as the next SDU. The number counts as used, whether or not the SDU is sent.
pub fn seal(keys: &mut LinkKeys, message: &HandshakeMessage) -> Vec<u8> {
    let mut sdu = message.encode();
    sdu.insert(0, HEAD);
    let Ok(_) = (keys.sealing).seal(&mut sdu, |_| Ok::<_, Infallible>(true));
    sdu
}

/// Opens and decodes a sealed message, which is the next SDU of the peer.
///
/// # Errors
/// Fails if the peer has not sealed it, or if it is not a message of the handshake.
pub fn open(keys: &mut LinkKeys, sdu: &mut [u8]) -> Result<HandshakeMessage, SealedMessageError> {
    let message = keys.opening.open(sdu)?.strip_prefix(&[HEAD]);
    Ok(HandshakeMessage::decode(
        message.ok_or(SealedMessageError::Data)?,
    )?)
}
