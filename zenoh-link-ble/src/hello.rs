//! Owns the hello: the first SDU each side sends, which makes "connected" true and settles version, MTU and
//! who is who. Layout and rules: `PROTOCOL.md`.
use std::fmt;

use crate::{
    lanes::credits::MIN_WINDOW,
    secret::{Nonce, Proof, NONCE_BYTES, PROOF_BYTES},
};

/// The first bytes of every hello, answer and refusal. Zenoh's own first message (InitSyn) has 0x01 in the low five
/// bits of its first byte, `R` (0x52) has not: a plain peer is told apart by one byte.
pub const MAGIC: [u8; 4] = *b"RECT";
/// The version of the wire format this crate speaks.
pub const VERSION: u8 = 1;
/// The longest hello accepted, in bytes; later versions may append fields up to here.
pub const MAX_SIZE: usize = 128;
/// The longest name, in bytes: what fits a scan response.
pub const MAX_NAME: usize = 29;
/// The smallest MTU either side may offer, in bytes: Zenoh's handshake needs about 100.
pub const MIN_MTU: u16 = 128;

const KIND_HELLO: u8 = 1;
const KIND_ACCEPT: u8 = 2;
const KIND_REFUSE: u8 = 3;
const KIND_CHALLENGE: u8 = 4;
const KIND_PROOF: u8 = 5;

/// Before the nonce of a hello, behind its name.
const NONCE_FOLLOWS: u8 = b'S';

/// A random number that tells one run of a node from another.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u64);

impl fmt::Debug for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

/// What a side says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hello {
    /// The highest version of the wire format it speaks; in an answer, the version chosen.
    pub version: u8,
    /// Who it is.
    pub node: NodeId,
    /// The largest Zenoh batch it takes, in bytes.
    pub mtu: u16,
    /// What it takes unacknowledged, in bytes (`lanes::credits`).
    pub window: u16,
    /// The name it goes by; may be empty.
    pub name: String,
    /// Only in the first hello, of a side that has a secret: what the listener is to prove with (`secret`).
    pub nonce: Option<Nonce>,
}

/// Why a link was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// It speaks no version that the other knows.
    Version,
    /// There is a link between the two already.
    AlreadyLinked,
    /// Both dialled at once, and the refusing side's dial goes first.
    Crossing,
    /// It has as many links as it was set to take.
    Full,
    /// Another robot of the same name is linked there, or the two have the same name.
    NameTaken,
    /// The two do not have the same secret.
    Secret,
    /// The hello, or the proof, does not follow the protocol.
    Malformed,
    /// A reason this version does not know.
    Other(u8),
}

impl Refusal {
    fn code(self) -> u8 {
        match self {
            Self::Version => 1,
            Self::AlreadyLinked => 2,
            Self::Crossing => 3,
            Self::Full => 4,
            Self::NameTaken => 5,
            Self::Secret => 6,
            Self::Malformed => 7,
            Self::Other(code) => code,
        }
    }

    fn from_code(code: u8) -> Self {
        match code {
            1 => Self::Version,
            2 => Self::AlreadyLinked,
            3 => Self::Crossing,
            4 => Self::Full,
            5 => Self::NameTaken,
            6 => Self::Secret,
            7 => Self::Malformed,
            other => Self::Other(other),
        }
    }

    /// Returns the reason as the refusing side logs it. [`fmt::Display`] is for the side that is refused.
    pub fn own_reason(self) -> &'static str {
        match self {
            Self::Version => "the two speak no common version of the link: update the older side",
            Self::AlreadyLinked => "the two are linked already",
            Self::Crossing => "both dialled at once, and this side's dial goes first",
            Self::Full => "this side has as many links as max_links allows",
            Self::NameTaken => {
                "its name is that of another robot or of this one: give one of the two another name="
            }
            Self::Secret => "the two do not have the same secret",
            Self::Malformed => "it does not follow the link protocol",
            Self::Other(_) => "for another reason",
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version => {
                f.write_str("it speaks another version of the link: update the older side")
            }
            Self::AlreadyLinked => f.write_str("the two are linked already"),
            Self::Crossing => f.write_str("both dialled at once, and its own dial goes first"),
            Self::Full => f.write_str("it has as many links as max_links allows"),
            Self::NameTaken => f.write_str(
                "a robot of this name is there already: give one of the two another name=",
            ),
            Self::Secret => f.write_str(
                "the two do not have the same secret: give both sides a secret= file with the same first line",
            ),
            Self::Malformed => f.write_str(
                "it cannot read what this side sent: one of the two does not follow the link protocol",
            ),
            Self::Other(code) => write!(f, "reason {code}, which this version does not know"),
        }
    }
}

/// One of the messages of the opening.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Opening {
    /// From the side that dialled.
    Hello(Hello),
    /// The answer that makes the link.
    Accept(Hello),
    /// The answer that does not.
    Refuse(Refusal),
    /// The answer of a listener with a secret: it proves that it has it, and asks the same of the dialler.
    Challenge(Challenge),
    /// The dialler's answer to that.
    Proof(Proof),
}

/// What a listener with a secret answers before anything else.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Challenge {
    /// Who it is.
    pub node: NodeId,
    /// What the dialler is to prove with.
    pub nonce: Nonce,
    /// That it has the secret itself.
    pub proof: Proof,
}

/// Why an SDU is not an opening.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OpeningError {
    /// It does not begin with [`MAGIC`].
    #[error("the first sdu is not a hello")]
    NotAHello,
    /// It ends too early, or is over [`MAX_SIZE`].
    #[error("a hello of {0} bytes has the wrong length")]
    Length(usize),
    /// Its kind is unknown.
    #[error("unknown kind {0} of opening message")]
    Kind(u8),
    /// Version 0 does not exist.
    #[error("version 0 does not exist")]
    Version,
    /// Its MTU is under [`MIN_MTU`].
    #[error("an mtu of {0} bytes is under the {MIN_MTU} that the handshake needs")]
    Mtu(u16),
    /// Its window is under [`MIN_WINDOW`].
    #[error("a window of {0} bytes is under the {MIN_WINDOW} that batches need")]
    Window(u16),
    /// Its name is too long or not UTF-8.
    #[error("the name is not valid: at most {MAX_NAME} bytes of utf-8")]
    Name,
}

impl OpeningError {
    /// Returns how a listener refuses a first SDU that it cannot decode; `None` if it answers nothing: to what is not this
    /// protocol's, and to answers (ACCEPT, REFUSE, CHALLENGE, PROOF), which belong to another channel.
    pub fn refusal(&self, sdu: &[u8]) -> Option<Refusal> {
        let kind = sdu.strip_prefix(&MAGIC)?.first();
        match (kind, self) {
            (Some(KIND_ACCEPT..=KIND_PROOF), _) => None,
            (_, Self::Version) => Some(Refusal::Version),
            _ => Some(Refusal::Malformed),
        }
    }
}

impl Opening {
    /// The SDU's bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut sdu = Vec::with_capacity(MAX_SIZE);
        sdu.extend_from_slice(&MAGIC);
        match self {
            Self::Hello(hello) => encode_hello(&mut sdu, KIND_HELLO, hello),
            Self::Accept(hello) => encode_hello(&mut sdu, KIND_ACCEPT, hello),
            Self::Refuse(refusal) => sdu.extend_from_slice(&[KIND_REFUSE, VERSION, refusal.code()]),
            Self::Challenge(challenge) => {
                sdu.extend_from_slice(&[KIND_CHALLENGE, VERSION]);
                sdu.extend_from_slice(&challenge.node.0.to_le_bytes());
                sdu.extend_from_slice(&challenge.nonce);
                sdu.extend_from_slice(&challenge.proof);
            }
            Self::Proof(proof) => {
                sdu.extend_from_slice(&[KIND_PROOF, VERSION]);
                sdu.extend_from_slice(proof);
            }
        }
        sdu
    }

    /// Reads an SDU. Bytes after the known fields are ignored, so that later versions may add some.
    pub fn decode(sdu: &[u8]) -> Result<Self, OpeningError> {
        let body = sdu.strip_prefix(&MAGIC).ok_or(OpeningError::NotAHello)?;
        let length = OpeningError::Length(sdu.len());
        if sdu.len() > MAX_SIZE {
            return Err(length);
        }
        let (&kind, body) = body.split_first().ok_or(length.clone())?;
        match kind {
            KIND_HELLO => decode_hello(body, length).map(Self::Hello),
            KIND_ACCEPT => decode_hello(body, length).map(Self::Accept),
            KIND_REFUSE => match body {
                [_version, code, ..] => Ok(Self::Refuse(Refusal::from_code(*code))),
                _ => Err(length),
            },
            KIND_CHALLENGE => decode_challenge(body, length).map(Self::Challenge),
            KIND_PROOF => match body.get(1..).and_then(|body| body.first_chunk()) {
                Some(&proof) => Ok(Self::Proof(proof)),
                None => Err(length),
            },
            other => Err(OpeningError::Kind(other)),
        }
    }
}

fn encode_hello(sdu: &mut Vec<u8>, kind: u8, hello: &Hello) {
    let name = &hello.name.as_bytes()[..hello.name.len().min(MAX_NAME)];
    sdu.extend_from_slice(&[kind, hello.version]);
    sdu.extend_from_slice(&hello.node.0.to_le_bytes());
    sdu.extend_from_slice(&hello.mtu.to_le_bytes());
    sdu.extend_from_slice(&hello.window.to_le_bytes());
    sdu.push(name.len() as u8);
    sdu.extend_from_slice(name);
    if let Some(nonce) = &hello.nonce {
        sdu.push(NONCE_FOLLOWS);
        sdu.extend_from_slice(nonce);
    }
}

fn decode_challenge(body: &[u8], length: OpeningError) -> Result<Challenge, OpeningError> {
    let (_version, body) = body.split_first().ok_or(length.clone())?;
    let (&node, body) = body.split_first_chunk::<8>().ok_or(length.clone())?;
    let (&nonce, body) = body
        .split_first_chunk::<NONCE_BYTES>()
        .ok_or(length.clone())?;
    let (&proof, _) = body.split_first_chunk::<PROOF_BYTES>().ok_or(length)?;
    Ok(Challenge {
        node: NodeId(u64::from_le_bytes(node)),
        nonce,
        proof,
    })
}

fn decode_hello(body: &[u8], length: OpeningError) -> Result<Hello, OpeningError> {
    let (&version, body) = body.split_first().ok_or(length.clone())?;
    if version == 0 {
        return Err(OpeningError::Version);
    }
    let (&node, body) = body.split_first_chunk::<8>().ok_or(length.clone())?;
    let (&mtu, body) = body.split_first_chunk::<2>().ok_or(length.clone())?;
    let (&window, body) = body.split_first_chunk::<2>().ok_or(length.clone())?;
    let (&name_length, body) = body.split_first().ok_or(length.clone())?;
    let name_length = usize::from(name_length);
    if name_length > MAX_NAME {
        return Err(OpeningError::Name);
    }
    let (name, rest) = body.split_at_checked(name_length).ok_or(length)?;
    let name = std::str::from_utf8(name).map_err(|_| OpeningError::Name)?;
    let nonce = match rest.split_first() {
        Some((&NONCE_FOLLOWS, rest)) => rest.first_chunk().copied(),
        _ => None,
    };
    let mtu = u16::from_le_bytes(mtu);
    if mtu < MIN_MTU {
        return Err(OpeningError::Mtu(mtu));
    }
    let window = u16::from_le_bytes(window);
    if window < MIN_WINDOW {
        return Err(OpeningError::Window(window));
    }
    Ok(Hello {
        version,
        node: NodeId(u64::from_le_bytes(node)),
        mtu,
        window,
        name: name.to_owned(),
        nonce,
    })
}

#[cfg(test)]
mod tests;
