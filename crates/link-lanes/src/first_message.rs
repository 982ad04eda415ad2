//! Decides what a listener does with the messages of a dialler before a link is open: which ones begin a link, and with which
//! reason the others are refused. For the rules see section 3 of `PROTOCOL.md`.
//!
//! The channels of Bluetooth and the connections of TCP follow the same rules.
use crate::{
    hello::{HandshakeMessage, HandshakeMessageError, Hello, Key, Refusal},
    key_agreement::KeyError,
    seal::{LinkKeys, NotAuthentic},
    sealed_message::{self, SealedMessageError},
    secret::Secret,
};

/// The first message of a dialler.
#[derive(Debug)]
pub enum FirstMessage<'a> {
    /// HELLO, to a listener without a secret.
    Hello(Hello),
    /// KEY, to a listener with this secret.
    Key(Key, &'a Secret),
    /// Zenoh's InitSyn, to a listener without a secret: the dialler is a plain peer.
    Plain,
}

/// Why a listener rejects a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Rejection {
    /// One of the two has no secret, or another one.
    #[error("the two do not have the same secret")]
    NoSharedSecret,
    /// The dialler refuses the listener's KEY ANSWER.
    #[error("the two do not have the same secret")]
    RefusedByDialler,
    /// The peer has not sealed the message as its next one: it has another secret, or repeats what somebody else has sent.
    #[error(transparent)]
    NotAuthentic(#[from] NotAuthentic),
    /// A plain peer cannot prove a secret.
    #[error("a plain peer has no secret")]
    PlainWithSecret,
    /// ACCEPT or KEY ANSWER: it answers this node's own first message, but on the channel that the peer has opened.
    #[error("it answered on the wrong channel")]
    Misdirected,
    /// REFUSE, where a dialler begins.
    #[error("it sent an answer instead of a hello")]
    Answer,
    /// A sealed message of another kind than HELLO, or an SDU of an open link.
    #[error("it sent something else before its hello")]
    NotHello,
    /// The message cannot be decoded. The reason of the refusal depends on its kind.
    #[error("{error}")]
    Invalid {
        /// The problem.
        error: HandshakeMessageError,
        /// The refusal, if the message is answered.
        refusal: Option<Refusal>,
    },
    /// The message of the key agreement is not valid.
    #[error(transparent)]
    Key(#[from] KeyError),
}

impl Rejection {
    /// Returns the reason with which the listener refuses, or `None` if it closes the channel without an answer.
    pub fn refusal(&self) -> Option<Refusal> {
        match self {
            Self::NoSharedSecret | Self::NotAuthentic(_) => Some(Refusal::Secret),
            Self::NotHello | Self::Key(_) => Some(Refusal::Malformed),
            Self::RefusedByDialler | Self::PlainWithSecret | Self::Misdirected | Self::Answer => {
                None
            }
            Self::Invalid { refusal, .. } => *refusal,
        }
    }

    /// Returns whether the refusal is sealed, if [`decide_sealed`] has rejected the message.
    pub fn is_sealed(&self) -> bool {
        matches!(self, Self::NotHello | Self::Invalid { .. })
    }
}

/// Decides about the first SDU of a dialler.
///
/// # Errors
/// Fails if the SDU does not begin a link with this listener.
pub fn decide<'a>(sdu: &[u8], secret: Option<&'a Secret>) -> Result<FirstMessage<'a>, Rejection> {
    if is_zenoh_init(sdu) {
        return match secret {
            Some(_) => Err(Rejection::PlainWithSecret),
            None => Ok(FirstMessage::Plain),
        };
    }
    let message = HandshakeMessage::decode(sdu).map_err(|error| {
        let refusal = error.refusal(sdu);
        Rejection::Invalid { error, refusal }
    })?;
    match (message, secret) {
        (HandshakeMessage::Hello(hello), None) => Ok(FirstMessage::Hello(hello)),
        (HandshakeMessage::Key(key), Some(secret)) => Ok(FirstMessage::Key(key, secret)),
        (HandshakeMessage::Hello(_) | HandshakeMessage::Key(_), _) => {
            Err(Rejection::NoSharedSecret)
        }
        (HandshakeMessage::Accept(_) | HandshakeMessage::KeyAnswer(_), _) => {
            Err(Rejection::Misdirected)
        }
        (HandshakeMessage::Refuse(_), _) => Err(Rejection::Answer),
    }
}

/// Decides about the SDU after KEY ANSWER, which has to be a sealed HELLO. If it opens, its sender has the secret, and then
/// a refusal is sealed, too ([`Rejection::is_sealed`]).
///
/// # Errors
/// Fails if it is anything else.
pub fn decide_sealed(keys: &mut LinkKeys, sdu: &mut [u8]) -> Result<Hello, Rejection> {
    // A dialler with another secret refuses, without keys to seal its refusal.
    if HandshakeMessage::decode(sdu) == Ok(HandshakeMessage::Refuse(Refusal::Secret)) {
        return Err(Rejection::RefusedByDialler);
    }
    match sealed_message::open(keys, sdu) {
        Ok(HandshakeMessage::Hello(hello)) => Ok(hello),
        Ok(_) | Err(SealedMessageError::Data) => Err(Rejection::NotHello),
        Err(SealedMessageError::NotAuthentic(error)) => Err(error.into()),
        Err(SealedMessageError::Message(error)) => {
            let refusal = match error {
                HandshakeMessageError::Version(_) => Refusal::Version,
                _ => Refusal::Malformed,
            };
            Err(Rejection::Invalid {
                error,
                refusal: Some(refusal),
            })
        }
    }
}

/// Returns whether the SDU is a Zenoh InitSyn: it has message id 1 in the low five bits, and more than a header.
fn is_zenoh_init(sdu: &[u8]) -> bool {
    sdu.len() > 1 && sdu.first().is_some_and(|byte| byte & 0x1f == 0x01)
}

#[cfg(test)]
mod tests;
