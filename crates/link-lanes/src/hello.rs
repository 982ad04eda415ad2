//! Encodes and decodes the messages of the handshake. Each side sends a [`Hello`], the dialler as HELLO and the
//! listener as ACCEPT. The two determine the version, the MTU and the identities of the nodes. With a secret, the messages
//! KEY and KEY ANSWER precede them, after which all SDUs are sealed.
//!
//! For the layout and the rules see section 3 of `PROTOCOL.md`.
use crate::{key_agreement::KeyMessage, lanes::credits::MIN_WINDOW};
use std::{fmt, ops::RangeInclusive};

pub use crate::node_id::NodeId;

/// The first bytes of every message of the handshake. Zenoh's own first message (InitSyn) has 0x01 in the low five bits of
/// its first byte and `R` (0x52) does not, so the first byte identifies a plain peer.
pub const MAGIC: [u8; 4] = *b"RECT";
/// The version of the wire format that this crate implements.
pub const VERSION: u8 = 2;
/// The largest message of the handshake, in bytes. Later versions may append fields up to this size.
pub const MAX_SIZE: usize = 128;
/// The longest name, in bytes: what fits into a scan response.
pub const MAX_NAME: usize = 29;
/// Largest number of connection intervals in a hello.
pub const MAX_INTERVALS: usize = 24;
/// The connection intervals that Bluetooth allows, in units of 1.25 ms (Core Specification, Vol 6, Part B, 4.5.1).
pub const INTERVAL_UNITS: RangeInclusive<u16> = 6..=3200;
/// The smallest MTU that either side may offer, in bytes: Zenoh's handshake needs about 100.
pub const MIN_MTU: u16 = 128;

const KIND_HELLO: u8 = 1;
const KIND_ACCEPT: u8 = 2;
const KIND_REFUSE: u8 = 3;
const KIND_KEY: u8 = 4;
const KIND_KEY_ANSWER: u8 = 5;

/// The byte that precedes the connection intervals of a hello, after the name.
const INTERVALS_FOLLOW: u8 = b'I';
/// The byte that precedes the fields of a path, after the intervals.
const PATH_FOLLOWS: u8 = b'P';
/// The byte of a sender that accepts compressed batches, after the fields of a path.
const ACCEPTS_COMPRESSED: u8 = b'C';

/// The content of HELLO and ACCEPT: the properties of the side that sends it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hello {
    /// From the dialler, the highest version of the wire format that it supports; from the listener, the version that it
    /// has chosen.
    pub version: u8,
    /// Node id of the sender.
    pub node: NodeId,
    /// The largest Zenoh batch that the sender accepts, in bytes; at least [`MIN_MTU`].
    pub mtu: u16,
    /// Number of bytes that the sender accepts unacknowledged (`lanes::credits`); at least [`MIN_WINDOW`].
    pub window: u16,
    /// Name of the sender, at most [`MAX_NAME`] bytes; may be empty.
    pub name: String,
    /// Connection intervals, at most [`MAX_INTERVALS`]: the one that the dialler requests, and then those that the link must
    /// avoid for the sender's sake. `None` if the sender cannot choose intervals.
    pub intervals: Option<IntervalUnits>,
    /// The link of which this channel becomes a path. `None` if the channel carries Zenoh's batches itself.
    pub path: Option<PathOf>,
    /// Whether the sender accepts compressed batches ([`compression`](crate::compression)).
    pub accepts_compressed: bool,
}

/// The link of which a channel becomes a path (crate `zenoh-link-any`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathOf {
    /// Random number of the link, chosen by the node that opens it.
    pub link: u64,
    /// Whether the link exists already.
    pub joins: bool,
}

/// The connection intervals in a hello, in units of 1.25 ms. A decoded hello contains only intervals in [`INTERVAL_UNITS`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct IntervalUnits {
    /// The interval that the dialler requests. The listener requests none.
    pub requested: Option<u16>,
    /// The intervals that the link must avoid because of other links of the sender.
    pub avoid: Vec<u16>,
}

/// Why a link was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The two have no common version.
    Version,
    /// There is a link between the two already.
    AlreadyLinked,
    /// Both dialled at the same time, and the dial of the refusing side takes precedence.
    Crossing,
    /// The refusing side has as many links as it accepts: over Bluetooth, as `max_links=` allows.
    Full,
    /// The refusing side has the same name, or a link with another robot of that name.
    NameTaken,
    /// The two do not have the same secret.
    Secret,
    /// A message of the handshake violates the protocol.
    Malformed,
    /// The refusing side does not have the link of which the channel should become a path.
    NoSuchLink,
    /// A reason that this version does not know, with its code.
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
            Self::NoSuchLink => 8,
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
            8 => Self::NoSuchLink,
            other => Self::Other(other),
        }
    }

    /// Returns the reason as the refusing side logs it. [`fmt::Display`] is for the side that is refused.
    pub fn own_reason(self) -> &'static str {
        match self {
            Self::Version => "the two support no common version of the link: update the older side",
            Self::AlreadyLinked => "the two are linked already",
            Self::Crossing => {
                "both dialled at the same time, and this side's dial takes precedence"
            }
            Self::Full => "this side has as many links as it accepts",
            Self::NameTaken => {
                "this robot or another linked one has the same name: give one of the two another name="
            }
            Self::Secret => "the two do not have the same secret",
            Self::Malformed => "it does not follow the link protocol",
            Self::NoSuchLink => "this side has no such link any more",
            Self::Other(_) => "for another reason",
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version => {
                f.write_str("it supports another version of the link: update the older side")
            }
            Self::AlreadyLinked => f.write_str("the two are linked already"),
            Self::Crossing => {
                f.write_str("both dialled at the same time, and its own dial takes precedence")
            }
            Self::Full => f.write_str("it has as many links as it accepts"),
            Self::NameTaken => f.write_str(
                "it has the same name, or a link with another robot of that name: give one of the two another name=",
            ),
            Self::Secret => f.write_str(
                "the two do not have the same secret: give both sides a secret= file with the same first line",
            ),
            Self::Malformed => f.write_str(
                "it cannot decode this side's message: one of the two does not follow the link protocol",
            ),
            Self::NoSuchLink => f.write_str("it has no such link any more"),
            Self::Other(code) => write!(f, "reason {code}, which is unknown to this version"),
        }
    }
}

/// A message of the handshake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HandshakeMessage {
    /// HELLO: the first message, from the dialler.
    Hello(Hello),
    /// ACCEPT: the answer that accepts the link.
    Accept(Hello),
    /// REFUSE: the answer that refuses the link.
    Refuse(Refusal),
    /// KEY: the first message of a dialler that has a secret.
    Key(Key),
    /// KEY ANSWER: the answer of a listener that has a secret.
    KeyAnswer(Key),
}

/// One side's part of the key agreement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key {
    /// The highest version of the wire format that the sender supports.
    pub version: u8,
    /// The message of the key agreement.
    pub message: KeyMessage,
}

impl Key {
    /// Returns what is sent before the message in KEY, which the key agreement authenticates.
    pub fn header(version: u8) -> [u8; 6] {
        let [a, b, c, d] = MAGIC;
        [a, b, c, d, KIND_KEY, version]
    }
}

/// Why an SDU is not a valid message of the handshake.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HandshakeMessageError {
    /// The SDU does not begin with [`MAGIC`].
    #[error("it sent an sdu that is not a message of the handshake")]
    NotAHello,
    /// The SDU is too short, or larger than [`MAX_SIZE`].
    #[error("a handshake message of {0} bytes has the wrong length")]
    Length(usize),
    /// The kind of the message is unknown.
    #[error("a handshake message has the unknown kind {0}")]
    Kind(u8),
    /// The version is older than [`VERSION`].
    #[error("it supports at most version {0} of the link, and this side needs version {VERSION}: update the older side")]
    Version(u8),
    /// The offered MTU is under [`MIN_MTU`].
    #[error("an mtu of {0} bytes is under the {MIN_MTU} that the handshake needs")]
    Mtu(u16),
    /// The offered window is under [`MIN_WINDOW`].
    #[error("a window of {0} bytes is under the {MIN_WINDOW} that batches need")]
    Window(u16),
    /// The name is too long or not UTF-8.
    #[error("the name is not valid: it must have at most {MAX_NAME} bytes of utf-8")]
    Name,
}

impl HandshakeMessageError {
    /// Returns the refusal with which a listener answers a first SDU that it cannot decode. Returns `None` if the
    /// listener does not answer: if the SDU is not of this protocol, or is an answer (ACCEPT, REFUSE,
    /// KEY ANSWER), which belongs to another channel.
    pub fn refusal(&self, sdu: &[u8]) -> Option<Refusal> {
        let kind = sdu.strip_prefix(&MAGIC)?.first();
        match (kind, self) {
            (Some(&(KIND_ACCEPT | KIND_REFUSE | KIND_KEY_ANSWER)), _) => None,
            (_, Self::Version(_)) => Some(Refusal::Version),
            _ => Some(Refusal::Malformed),
        }
    }
}

impl HandshakeMessage {
    /// Encodes the message as an SDU.
    pub fn encode(&self) -> Vec<u8> {
        let mut sdu = Vec::with_capacity(MAX_SIZE);
        sdu.extend_from_slice(&MAGIC);
        match self {
            Self::Hello(hello) => encode_hello(&mut sdu, KIND_HELLO, hello),
            Self::Accept(hello) => encode_hello(&mut sdu, KIND_ACCEPT, hello),
            Self::Refuse(refusal) => sdu.extend_from_slice(&[KIND_REFUSE, VERSION, refusal.code()]),
            Self::Key(key) => encode_key(&mut sdu, KIND_KEY, key),
            Self::KeyAnswer(key) => encode_key(&mut sdu, KIND_KEY_ANSWER, key),
        }
        sdu
    }

    /// Decodes an untrusted SDU. Bytes after the known fields are ignored, so that later versions may add some.
    ///
    /// # Errors
    /// Fails if the SDU is not a message of the handshake, or has an invalid field.
    pub fn decode(sdu: &[u8]) -> Result<Self, HandshakeMessageError> {
        let body = sdu
            .strip_prefix(&MAGIC)
            .ok_or(HandshakeMessageError::NotAHello)?;
        let length = HandshakeMessageError::Length(sdu.len());
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
            KIND_KEY => decode_key(body, length).map(Self::Key),
            KIND_KEY_ANSWER => decode_key(body, length).map(Self::KeyAnswer),
            other => Err(HandshakeMessageError::Kind(other)),
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
    if let Some(intervals) = &hello.intervals {
        encode_intervals(sdu, intervals);
    }
    if let Some(path) = &hello.path {
        sdu.extend_from_slice(&[PATH_FOLLOWS, u8::from(path.joins)]);
        sdu.extend_from_slice(&path.link.to_le_bytes());
    }
    if hello.accepts_compressed {
        sdu.push(ACCEPTS_COMPRESSED);
    }
}

/// Encodes the intervals. Zero stands for no requested interval.
fn encode_intervals(sdu: &mut Vec<u8>, intervals: &IntervalUnits) {
    let requested = intervals.requested.unwrap_or(0);
    let avoid = intervals.avoid.iter().take(MAX_INTERVALS - 1);
    sdu.extend_from_slice(&[INTERVALS_FOLLOW, 1 + avoid.len() as u8]);
    for units in std::iter::once(requested).chain(avoid.copied()) {
        sdu.extend_from_slice(&units.to_le_bytes());
    }
}

/// Splits off the fields of a path, if they come next.
fn split_path(rest: &[u8]) -> (Option<PathOf>, &[u8]) {
    let [PATH_FOLLOWS, joins, body @ ..] = rest else {
        return (None, rest);
    };
    let Some((&link, rest)) = body.split_first_chunk() else {
        return (None, &[]);
    };
    let path = PathOf {
        link: u64::from_le_bytes(link),
        joins: joins & 1 == 1,
    };
    (Some(path), rest)
}

/// Splits off the connection intervals, if they come next.
fn split_intervals(rest: &[u8]) -> (Option<&[u8]>, &[u8]) {
    let [INTERVALS_FOLLOW, count, body @ ..] = rest else {
        return (None, rest);
    };
    match body.split_at_checked(2 * usize::from(*count)) {
        Some((units, rest)) => (Some(units), rest),
        None => (None, &[]),
    }
}

/// Decodes the intervals. Returns `None` if they are not valid: the link works without them.
fn decode_intervals(units: &[u8]) -> Option<IntervalUnits> {
    if units.len() > 2 * MAX_INTERVALS {
        return None;
    }
    let mut units = units.chunks_exact(2).map(|bytes| match bytes {
        [low, high] => u16::from_le_bytes([*low, *high]),
        _ => 0,
    });
    let requested = match units.next()? {
        0 => None,
        units => Some(valid_interval(units)?),
    };
    let avoid = units.map(valid_interval);
    Some(IntervalUnits {
        requested,
        avoid: avoid.collect::<Option<_>>()?,
    })
}

fn valid_interval(units: u16) -> Option<u16> {
    INTERVAL_UNITS.contains(&units).then_some(units)
}

fn encode_key(sdu: &mut Vec<u8>, kind: u8, key: &Key) {
    sdu.extend_from_slice(&[kind, key.version]);
    sdu.extend_from_slice(&key.message);
}

fn decode_key(body: &[u8], length: HandshakeMessageError) -> Result<Key, HandshakeMessageError> {
    let (version, body) = decode_version(body, length.clone())?;
    let (&message, _) = body.split_first_chunk().ok_or(length)?;
    Ok(Key { version, message })
}

fn decode_version(
    body: &[u8],
    length: HandshakeMessageError,
) -> Result<(u8, &[u8]), HandshakeMessageError> {
    let (&version, body) = body.split_first().ok_or(length)?;
    match version {
        0..VERSION => Err(HandshakeMessageError::Version(version)),
        version => Ok((version, body)),
    }
}

fn decode_hello(
    body: &[u8],
    length: HandshakeMessageError,
) -> Result<Hello, HandshakeMessageError> {
    let (version, body) = decode_version(body, length.clone())?;
    let (&node, body) = body.split_first_chunk::<8>().ok_or(length.clone())?;
    let (&mtu, body) = body.split_first_chunk::<2>().ok_or(length.clone())?;
    let (&window, body) = body.split_first_chunk::<2>().ok_or(length.clone())?;
    let (&name_length, body) = body.split_first().ok_or(length.clone())?;
    let name_length = usize::from(name_length);
    if name_length > MAX_NAME {
        return Err(HandshakeMessageError::Name);
    }
    let (name, rest) = body.split_at_checked(name_length).ok_or(length)?;
    let name = std::str::from_utf8(name).map_err(|_| HandshakeMessageError::Name)?;
    let (intervals, rest) = split_intervals(rest);
    let (path, rest) = split_path(rest);
    let mtu = u16::from_le_bytes(mtu);
    if mtu < MIN_MTU {
        return Err(HandshakeMessageError::Mtu(mtu));
    }
    let window = u16::from_le_bytes(window);
    if window < MIN_WINDOW {
        return Err(HandshakeMessageError::Window(window));
    }
    Ok(Hello {
        version,
        node: NodeId(u64::from_le_bytes(node)),
        mtu,
        window,
        name: name.to_owned(),
        intervals: intervals.and_then(decode_intervals),
        path,
        accepts_compressed: rest.first() == Some(&ACCEPTS_COMPRESSED),
    })
}

#[cfg(test)]
mod tests;
