//! Encodes the offer of a transfer: the sender's description of what it sends.
use std::fmt;

use sha2::{Digest, Sha256};

use super::wire::{write_number, write_text, Reader};
use crate::{
    message::encoding::{self, Encoding},
    name::{
        topic::{self, Topic},
        Name,
    },
    text::display::is_harmful,
};

const VERSION: u8 = 1;
/// The maximum length of a file name, in bytes.
pub const MAX_NAME_BYTES: usize = 120;
/// The maximum length of an offer, in bytes.
pub const MAX_BYTES: usize = 700;

/// The offer of a transfer.
#[derive(Clone, PartialEq, Eq)]
pub struct Offer {
    /// Robot that makes the offer, according to the offer itself. The receiver asks that robot for confirmation
    /// ([`super::admission`]).
    pub sender: Name,
    /// Topic of the transfer.
    pub topic: Topic,
    /// File name under which a receiver stores the transfer in a folder. May be empty.
    pub name: FileName,
    /// Encoding of the data.
    pub encoding: Encoding,
    /// Size of the data, in bytes.
    pub size_bytes: u64,
    /// Checksum of the data.
    pub checksum: Checksum,
    /// Random number that identifies the program's call to send the data. A repeated offer has the same number; if the
    /// program sends the same data with another call, the number differs. An interrupted transfer continues under any
    /// number.
    pub call: u64,
}

/// SHA-256 of the data. It can be verified with standard tools (`sha256sum`), needs neither C nor assembly, runs in
/// hardware on current processors (1 GB/s and more), and is faster than the links of a robot on all others.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Checksum(pub [u8; 32]);

/// The id of a transfer. The same data under the same name to the same receiver has the same id, so that the transfer
/// continues after a restart of either side.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TransferId(u64);

/// A valid file name: a single path component that is not hidden.
#[derive(Clone, Default, PartialEq, Eq, Hash)]
pub struct FileName(String);

/// The bytes are not a valid offer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OfferError {
    /// The offer has an unsupported version.
    #[error("the offer has version {0}, but this program supports version {VERSION}: update RECT on this robot")]
    Version(u8),
    /// The offer is truncated or too long, or the bytes are something else.
    #[error("invalid offer of a transfer: its {0} cannot be read")]
    Malformed(&'static str),
    /// The file name is too long, contains a character that is not allowed, or is that of a hidden file.
    #[error(
        "{0:?} is not a valid file name: use up to {MAX_NAME_BYTES} bytes, no `/`, `\\` or `:`, no control or \
         invisible characters, no `.` at the beginning"
    )]
    Name(String),
}

impl Offer {
    /// Returns the id of the transfer to the receiver `to`.
    pub fn id(&self, to: &Name) -> TransferId {
        let mut all = Vec::new();
        write_text(&mut all, to.as_str());
        self.write_content(&mut all);
        TransferId::of(&all)
    }

    /// Returns whether both offers have the same content, regardless of the call.
    pub fn is_same(&self, other: &Self) -> bool {
        let call = self.call;
        *self
            == Self {
                call,
                ..other.clone()
            }
    }

    /// Encodes the offer.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![VERSION];
        bytes.extend_from_slice(&self.call.to_le_bytes());
        self.write_content(&mut bytes);
        bytes
    }

    fn write_content(&self, out: &mut Vec<u8>) {
        write_text(out, self.sender.as_str());
        write_text(out, self.topic.as_str());
        write_text(out, self.name.as_str());
        write_text(out, self.encoding.as_str());
        write_number(out, self.size_bytes);
        out.extend_from_slice(&self.checksum.0);
    }

    /// Decodes an untrusted offer.
    ///
    /// # Errors
    /// Returns an [`OfferError`] that explains why the bytes are not a valid offer.
    pub fn decode(bytes: &[u8]) -> Result<Self, OfferError> {
        use OfferError::Malformed;
        if bytes.len() > MAX_BYTES {
            return Err(Malformed("length"));
        }
        let mut reader = Reader(bytes);
        match reader.byte() {
            Some(VERSION) => {}
            Some(other) => return Err(OfferError::Version(other)),
            None => return Err(Malformed("version")),
        }
        let call = reader.array().ok_or(Malformed("call"))?;
        let sender = reader.text(crate::name::MAX_BYTES);
        // The sender becomes a folder's name, which must not be hidden, but the name of a robot may begin with a dot.
        let sender = sender.filter(|text| !text.starts_with('.'));
        let sender = sender.and_then(|text| Name::new(text).ok());
        let topic = reader.text(topic::MAX_BYTES);
        let topic = topic.and_then(|text| Topic::new(text).ok());
        let (sender, topic) = (
            sender.ok_or(Malformed("sender"))?,
            topic.ok_or(Malformed("topic"))?,
        );
        let name = reader.text(MAX_BYTES).ok_or(Malformed("name"))?;
        let name = FileName::new(name)?;
        let encoding = reader.text(encoding::MAX_BYTES);
        let encoding = Encoding::new(encoding.ok_or(Malformed("encoding"))?.to_owned());
        let size_bytes = reader.number().ok_or(Malformed("size"))?;
        let checksum = Checksum(reader.array().ok_or(Malformed("checksum"))?);
        reader.end().ok_or(Malformed("end"))?;
        Ok(Self {
            sender,
            topic,
            name,
            encoding,
            size_bytes,
            checksum,
            call: u64::from_le_bytes(call),
        })
    }
}

impl FileName {
    /// Creates a file name after checking it. The empty name stands for data without a name.
    ///
    /// # Errors
    /// Returns [`OfferError::Name`] if the name is longer than [`MAX_NAME_BYTES`], contains `/`, `\`, `:`, a control
    /// character or one that makes text read differently, or begins with `.`.
    pub fn new(text: &str) -> Result<Self, OfferError> {
        let bad = |c: char| is_harmful(c) || matches!(c, '/' | '\\' | ':');
        if text.len() > MAX_NAME_BYTES || text.starts_with('.') || text.contains(bad) {
            return Err(OfferError::Name(
                super::wire::cut(text, MAX_NAME_BYTES).to_owned(),
            ));
        }
        Ok(Self(text.to_owned()))
    }

    /// Returns the file name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TransferId {
    /// Returns the id of what these bytes describe.
    pub fn of(description: &[u8]) -> Self {
        let hash = Checksum::of(description).0;
        let first = hash.first_chunk().copied().unwrap_or_default();
        Self(u64::from_be_bytes(first))
    }

    /// Reads an id: 16 hexadecimal digits. Returns `None` for any other text.
    pub fn parse(text: &str) -> Option<Self> {
        digits(text).map(|bytes| Self(u64::from_be_bytes(bytes)))
    }
}

impl Checksum {
    /// Computes the checksum of bytes in memory.
    pub fn of(bytes: &[u8]) -> Self {
        Self(Sha256::digest(bytes).into())
    }

    /// Reads a checksum: 64 hexadecimal digits. Returns `None` for any other text.
    pub fn parse(text: &str) -> Option<Self> {
        digits(text).map(Self)
    }
}

/// Reads bytes as hexadecimal digits.
fn digits<const N: usize>(text: &str) -> Option<[u8; N]> {
    let is_valid = text.len() == 2 * N && text.bytes().all(|digit| digit.is_ascii_hexdigit());
    let mut bytes = [0; N];
    for (at, byte) in bytes.iter_mut().enumerate() {
        let digits = text.get(2 * at..2 * at + 2).filter(|_| is_valid)?;
        *byte = u8::from_str_radix(digits, 16).ok()?;
    }
    Some(bytes)
}

impl fmt::Display for TransferId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

impl fmt::Debug for TransferId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

impl fmt::Display for Checksum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Checksum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

impl fmt::Display for FileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for FileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.0)
    }
}

impl fmt::Debug for Offer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            sender,
            topic,
            name,
            encoding,
            size_bytes,
            ..
        } = self;
        write!(
            f,
            "Offer({sender}/{topic}, {name:?}, {encoding}, {size_bytes} bytes)"
        )
    }
}

/// An offer for the tests of this folder.
#[cfg(test)]
pub(super) fn sample(size_bytes: u64) -> Offer {
    Offer {
        sender: Name::new("wombat-1").expect("valid name"),
        topic: Topic::new("map/kitchen").expect("valid topic"),
        name: FileName::new("kitchen.pcd").expect("valid file name"),
        encoding: Encoding::BYTES,
        size_bytes,
        checksum: Checksum::of(b"abc"),
        call: 7,
    }
}

#[cfg(test)]
mod tests;
