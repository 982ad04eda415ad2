//! Proves that a TCP connection belongs to a link, and encrypts it. For the rules see section 4 of `PROTOCOL.md`.
//!
//! Both sides have derived the same key from the handshake of the link's Bluetooth path. It is the pre-shared key of a Noise
//! handshake on the connection, and is never sent.
use snow::{params::NoiseParams, Builder, HandshakeState, StatelessTransportState};

const PROTOCOL: &str = "Noise_NNpsk0_25519_ChaChaPoly_SHA256";
/// The first bytes of a connection, with the version.
pub(crate) const MAGIC: [u8; 6] = *b"RECTA\x01";
/// Size of a message of the handshake, in bytes: a public key of X25519 and a tag.
pub(crate) const MESSAGE_BYTES: usize = 48;
/// Size of the dialler's first message, in bytes.
pub(crate) const OPENING_BYTES: usize = MAGIC.len() + TAG_BYTES + MESSAGE_BYTES;
const TAG_BYTES: usize = 8;
/// Size of the tag that encryption adds to a frame, in bytes.
pub(crate) const SEAL_BYTES: usize = 16;
/// The labels of the keys that are derived from the handshake of the Bluetooth path.
pub(crate) const KEY_LABEL: &str = "any key";
pub(crate) const TAG_LABEL: &str = "any tag";

/// Identifies a link to a listener, without revealing anything about it.
pub(crate) type Tag = [u8; TAG_BYTES];

/// Whether a side has opened the link, on Bluetooth. A connection that comes back to its own side fails, because the dialler of
/// a connection and its listener have different roles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// It has dialled.
    Opener,
    /// It was dialled.
    Acceptor,
}

impl Role {
    fn other(self) -> Self {
        match self {
            Self::Opener => Self::Acceptor,
            Self::Acceptor => Self::Opener,
        }
    }
}

/// The keys with which one side of a link proves that a connection belongs to it.
#[derive(Clone)]
pub(crate) struct Proof {
    pub(crate) tag: Tag,
    key: [u8; 32],
    role: Role,
}

/// The connection does not belong to this link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the connection does not belong to the link")]
pub(crate) struct NotProven;

impl Proof {
    pub(crate) fn new(key: [u8; 32], tag: [u8; 32], role: Role) -> Self {
        let mut short = Tag::default();
        short.copy_from_slice(&tag[..TAG_BYTES]);
        Self {
            tag: short,
            key,
            role,
        }
    }

    /// Begins as the dialler of a connection, and returns its first message.
    pub(crate) fn open(&self) -> Result<(Opening, Vec<u8>), NotProven> {
        self.open_with(None)
    }

    /// Begins with a given ephemeral key, for the test vectors.
    pub(crate) fn open_with(
        &self,
        ephemeral: Option<&[u8; 32]>,
    ) -> Result<(Opening, Vec<u8>), NotProven> {
        let builder = builder(self.role, &self.key, ephemeral).ok_or(NotProven)?;
        let mut state = builder.build_initiator().map_err(|_| NotProven)?;
        let mut message = [0; MESSAGE_BYTES];
        state
            .write_message(&[], &mut message)
            .map_err(|_| NotProven)?;
        Ok((Opening(state), [&MAGIC[..], &self.tag, &message].concat()))
    }

    /// Answers a first message as the listener of a connection.
    pub(crate) fn answer(
        &self,
        opening: &[u8; OPENING_BYTES],
    ) -> Result<([u8; MESSAGE_BYTES], StatelessTransportState), NotProven> {
        self.answer_with(opening, None)
    }

    /// Answers with a given ephemeral key, for the test vectors.
    pub(crate) fn answer_with(
        &self,
        opening: &[u8; OPENING_BYTES],
        ephemeral: Option<&[u8; 32]>,
    ) -> Result<([u8; MESSAGE_BYTES], StatelessTransportState), NotProven> {
        let builder = builder(self.role.other(), &self.key, ephemeral).ok_or(NotProven)?;
        let mut state = builder.build_responder().map_err(|_| NotProven)?;
        let message = &opening[MAGIC.len() + TAG_BYTES..];
        state
            .read_message(message, &mut [])
            .map_err(|_| NotProven)?;
        let mut answer = [0; MESSAGE_BYTES];
        state
            .write_message(&[], &mut answer)
            .map_err(|_| NotProven)?;
        let transport = state.into_stateless_transport_mode();
        Ok((answer, transport.map_err(|_| NotProven)?))
    }
}

/// The dialler's side of a handshake.
pub(crate) struct Opening(HandshakeState);

impl Opening {
    pub(crate) fn finish(
        mut self,
        answer: &[u8; MESSAGE_BYTES],
    ) -> Result<StatelessTransportState, NotProven> {
        self.0
            .read_message(answer, &mut [])
            .map_err(|_| NotProven)?;
        let transport = self.0.into_stateless_transport_mode();
        transport.map_err(|_| NotProven)
    }
}

/// Returns the tag of the link that a first message names.
pub(crate) fn tag_of(opening: &[u8; OPENING_BYTES]) -> Option<Tag> {
    let rest = opening.strip_prefix(&MAGIC)?;
    rest.first_chunk().copied()
}

fn builder<'a>(
    dialler: Role,
    key: &'a [u8; 32],
    ephemeral: Option<&'a [u8; 32]>,
) -> Option<Builder<'a>> {
    let params: NoiseParams = PROTOCOL.parse().ok()?;
    let prologue: &[u8] = match dialler {
        Role::Opener => b"RECT any 1 opener",
        Role::Acceptor => b"RECT any 1 acceptor",
    };
    let builder = Builder::new(params).prologue(prologue).ok()?;
    let builder = builder.psk(0, key).ok()?;
    Some(match ephemeral {
        Some(key) => builder.fixed_ephemeral_key_for_testing_only(key),
        None => builder,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn proof(key: u8, role: Role) -> Proof {
        Proof::new([key; 32], [9; 32], role)
    }

    fn opening(proof: &Proof) -> (Opening, [u8; OPENING_BYTES]) {
        let (opening, message) = proof.open().expect("opens");
        (opening, message.try_into().expect("of that size"))
    }

    #[test]
    fn both_sides_of_a_link_agree_whoever_dials() {
        for (dialler, listener) in [
            (Role::Opener, Role::Acceptor),
            (Role::Acceptor, Role::Opener),
        ] {
            let (opening, message) = opening(&proof(1, dialler));
            assert_eq!(tag_of(&message), Some([9; 8]));
            let (answer, two) = proof(1, listener).answer(&message).expect("proven");
            let one = opening.finish(&answer).expect("proven");
            let (mut sealed, mut opened) = ([0; 100], [0; 100]);
            let size = one.write_message(7, b"frame", &mut sealed).expect("seals");
            assert_eq!(size, 5 + SEAL_BYTES);
            let read = two.read_message(7, &sealed[..size], &mut opened);
            assert_eq!(read.ok(), Some(5));
            assert!(two.read_message(8, &sealed[..size], &mut opened).is_err());
        }
    }

    #[test]
    fn others_are_rejected() {
        let (_, message) = opening(&proof(1, Role::Opener));
        assert!(
            proof(2, Role::Acceptor).answer(&message).is_err(),
            "another key"
        );
        assert!(
            proof(1, Role::Opener).answer(&message).is_err(),
            "reflected"
        );
        for at in MAGIC.len() + TAG_BYTES..OPENING_BYTES {
            let mut changed = message;
            changed[at] ^= 1;
            assert!(
                proof(1, Role::Acceptor).answer(&changed).is_err(),
                "byte {at}"
            );
        }
        let (other, _) = opening(&proof(1, Role::Opener));
        let (answer, _) = proof(1, Role::Acceptor).answer(&message).expect("proven");
        assert!(
            other.finish(&answer).is_err(),
            "the answer to another connection"
        );
        let mut not_ours = message;
        not_ours[0] = b'X';
        assert_eq!(tag_of(&not_ours), None);
    }
}
