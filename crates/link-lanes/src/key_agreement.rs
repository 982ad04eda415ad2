//! Agrees on the keys of a link between two nodes with the same secret: the Noise handshake NNpsk2. Each side proves that it
//! has the secret, and what was recorded stays unreadable if the secret becomes known later.
//!
//! For the rules see section 3 of `PROTOCOL.md`.
use snow::{params::NoiseParams, Builder, HandshakeState};

use crate::{
    seal::{derive, Derived, LinkKeys},
    secret::Secret,
};

/// Size of a message of the key agreement, in bytes: a public key of X25519 and a tag.
pub const KEY_MESSAGE_BYTES: usize = 48;
/// A message of the key agreement.
pub type KeyMessage = [u8; KEY_MESSAGE_BYTES];

const PROTOCOL: &str = "Noise_NNpsk2_25519_ChaChaPoly_SHA256";
const DIALLER_LABEL: &[u8] = b"RECT link 2 dialler";
const LISTENER_LABEL: &[u8] = b"RECT link 2 listener";
const EXPORT_LABEL: &[u8] = b"RECT link 2 export ";

/// Why the two sides cannot agree on keys.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// The peer has another secret, or a message was changed on the way.
    #[error("the two do not have the same secret")]
    NoSharedSecret,
    /// The handshake cannot be performed, with the reason.
    #[error("cannot agree on keys: {0}")]
    Failed(String),
}

/// The result of a key agreement.
#[derive(Debug)]
pub struct Agreed {
    /// The keys of the link.
    pub keys: LinkKeys,
    /// Derives keys for other uses.
    pub exporter: Exporter,
}

/// Derives keys from a key agreement for other uses than its link. Both sides derive the same ones.
pub struct Exporter(Derived);

impl std::fmt::Debug for Exporter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Exporter(..)")
    }
}

impl Exporter {
    /// Derives the key for the use that `label` names.
    pub fn key(&self, label: &str) -> Derived {
        derive(&self.0, &[EXPORT_LABEL, label.as_bytes()].concat())
    }
}

/// The dialler's side of a key agreement, between its message and the listener's.
pub struct Initiator(HandshakeState);

impl Initiator {
    /// Begins a key agreement, and returns the message for the listener. `header` is what is sent before that message; a
    /// change of it on the way is detected.
    ///
    /// # Errors
    /// Fails if the operating system provides no random numbers.
    pub fn start(secret: &Secret, header: &[u8]) -> Result<(Self, KeyMessage), KeyError> {
        Self::start_with(secret, header, None)
    }

    /// Begins a key agreement with a given ephemeral key, for the test vectors.
    fn start_with(
        secret: &Secret,
        header: &[u8],
        ephemeral: Option<&Derived>,
    ) -> Result<(Self, KeyMessage), KeyError> {
        let psk = secret.pre_shared_key();
        let mut state = builder(header, &psk, ephemeral)?
            .build_initiator()
            .map_err(failed)?;
        let mut message = [0; KEY_MESSAGE_BYTES];
        state.write_message(&[], &mut message).map_err(failed)?;
        Ok((Self(state), message))
    }

    /// Ends the key agreement with the listener's message.
    ///
    /// # Errors
    /// Fails if the listener does not have the secret.
    pub fn finish(mut self, message: &KeyMessage) -> Result<Agreed, KeyError> {
        let read = self.0.read_message(message, &mut []);
        read.map_err(|_| KeyError::NoSharedSecret)?;
        Ok(agreed(&mut self.0, Role::Dialler))
    }
}

/// Answers a key agreement as the listener, and returns the message for the dialler. The dialler has proved the secret only
/// once an SDU of it can be opened with the keys.
///
/// # Errors
/// Fails if the message is not valid, or if the operating system provides no random numbers.
pub fn respond(
    secret: &Secret,
    header: &[u8],
    message: &KeyMessage,
) -> Result<(KeyMessage, Agreed), KeyError> {
    respond_with(secret, header, message, None)
}

/// Answers a key agreement with a given ephemeral key, for the test vectors.
fn respond_with(
    secret: &Secret,
    header: &[u8],
    message: &KeyMessage,
    ephemeral: Option<&Derived>,
) -> Result<(KeyMessage, Agreed), KeyError> {
    let psk = secret.pre_shared_key();
    let mut state = builder(header, &psk, ephemeral)?
        .build_responder()
        .map_err(failed)?;
    state.read_message(message, &mut []).map_err(failed)?;
    let mut answer = [0; KEY_MESSAGE_BYTES];
    state.write_message(&[], &mut answer).map_err(failed)?;
    Ok((answer, agreed(&mut state, Role::Listener)))
}

enum Role {
    Dialler,
    Listener,
}

fn builder<'a>(
    header: &'a [u8],
    psk: &'a Derived,
    ephemeral: Option<&'a Derived>,
) -> Result<Builder<'a>, KeyError> {
    let params: NoiseParams = PROTOCOL.parse().map_err(failed)?;
    let builder = Builder::new(params).prologue(header).map_err(failed)?;
    let builder = builder.psk(2, psk).map_err(failed)?;
    Ok(match ephemeral {
        Some(key) => builder.fixed_ephemeral_key_for_testing_only(key),
        None => builder,
    })
}

/// Derives the keys of a completed handshake.
fn agreed(state: &mut HandshakeState, role: Role) -> Agreed {
    let (one, two) = state.dangerously_get_raw_split();
    let root = derive(&[one, two].concat(), state.get_handshake_hash());
    let dialler = derive(&root, DIALLER_LABEL);
    let listener = derive(&root, LISTENER_LABEL);
    let keys = match role {
        Role::Dialler => LinkKeys::new(dialler, listener),
        Role::Listener => LinkKeys::new(listener, dialler),
    };
    Agreed {
        keys,
        exporter: Exporter(root),
    }
}

fn failed(error: snow::Error) -> KeyError {
    KeyError::Failed(error.to_string())
}

#[cfg(test)]
mod tests;
