//! Owns the offer: what a sender says of what it has.
use std::fmt;

use sha2::{Digest, Sha256};

use super::wire::{write_number, write_text, Reader};
use crate::core::{
    encoding::{self, Encoding},
    name::Name,
    topic::{self, Topic},
};

const VERSION: u8 = 1;
/// The longest name of a file, in bytes.
pub const MAX_NAME_BYTES: usize = 120;
/// The longest offer, in bytes.
pub const MAX_BYTES: usize = 700;

/// What is offered, and by whom.
#[derive(Clone, PartialEq, Eq)]
pub struct Offer {
    /// The robot that has it, as the offer claims. The receiver asks that robot before it believes it
    /// ([`super::inbox`]).
    pub from: Name,
    /// About what.
    pub topic: Topic,
    /// What it is called; becomes the file's name where it is kept in a file. May be empty.
    pub name: FileName,
    /// What it is.
    pub encoding: Encoding,
    /// How long it is.
    pub size_bytes: u64,
    /// What its bytes come to.
    pub checksum: Checksum,
    /// Drawn for each call of the program: the same offered again is the same transfer, and the same bytes sent again
    /// by the program's wish are another. A transfer that was interrupted goes on under whatever number.
    pub call: u64,
}

/// SHA-256 of all the bytes: what every machine can check with a tool that it has (`sha256sum`), written without C or
/// assembly, in hardware on current processors (1 GB/s and more), and faster than any link of a robot without.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Checksum(pub [u8; 32]);

/// Which transfer: the same for the same bytes under the same name to the same receiver, so that it goes on after either
/// side was restarted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TransferId(u64);

/// What a file may be called: one part of a path, which is not hidden and leads nowhere else.
#[derive(Clone, Default, PartialEq, Eq, Hash)]
pub struct FileName(String);

/// The bytes are no offer, or one that can't be taken whatever the receiver wants.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OfferError {
    /// Of a later version of RECT.
    #[error("an offer of version {0}; this is version {VERSION}: update RECT here")]
    Version(u8),
    /// Cut off, too long, or not an offer at all.
    #[error("not an offer of a transfer: its {0} can't be read")]
    Malformed(&'static str),
    /// A name that could lead somewhere else on the disk.
    #[error(
        "{0:?} can't name a file here: up to {MAX_NAME_BYTES} bytes, no `/` or `\\`, no control characters, \
         no `.` at the beginning"
    )]
    Name(String),
}

impl Offer {
    /// Which transfer it is, to this receiver.
    pub fn id(&self, to: &Name) -> TransferId {
        let mut all = Vec::new();
        write_text(&mut all, to.as_str());
        self.write_content(&mut all);
        let hash: [u8; 32] = Sha256::digest(&all).into();
        let first = hash.first_chunk().copied().unwrap_or_default();
        TransferId(u64::from_be_bytes(first))
    }

    /// The same content, whatever the call.
    pub fn is_same(&self, other: &Self) -> bool {
        let call = self.call;
        *self
            == Self {
                call,
                ..other.clone()
            }
    }

    /// As bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![VERSION];
        bytes.extend_from_slice(&self.call.to_le_bytes());
        self.write_content(&mut bytes);
        bytes
    }

    fn write_content(&self, out: &mut Vec<u8>) {
        write_text(out, self.from.as_str());
        write_text(out, self.topic.as_str());
        write_text(out, self.name.as_str());
        write_text(out, self.encoding.as_str());
        write_number(out, self.size_bytes);
        out.extend_from_slice(&self.checksum.0);
    }

    /// From bytes that anyone may have sent.
    ///
    /// # Errors
    /// [`OfferError`]: what is wrong with them.
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
        let from = reader.text(crate::core::name::MAX_BYTES);
        // It becomes a folder's name, and `..` is a name.
        let from = from.filter(|text| !text.starts_with('.'));
        let from = from.and_then(|text| Name::new(text).ok());
        let topic = reader.text(topic::MAX_BYTES);
        let topic = topic.and_then(|text| Topic::new(text).ok());
        let (from, topic) = (
            from.ok_or(Malformed("sender"))?,
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
            from,
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
    /// Checks a name. The empty one is for what has none.
    ///
    /// # Errors
    /// [`OfferError::Name`]: it could lead somewhere else, or be hidden.
    pub fn new(text: &str) -> Result<Self, OfferError> {
        let bad = |c: char| c.is_control() || matches!(c, '/' | '\\' | ':');
        if text.len() > MAX_NAME_BYTES || text.starts_with('.') || text.contains(bad) {
            return Err(OfferError::Name(
                super::wire::cut(text, MAX_NAME_BYTES).to_owned(),
            ));
        }
        Ok(Self(text.to_owned()))
    }

    /// As text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl Checksum {
    /// Of bytes that are at hand.
    pub fn of(bytes: &[u8]) -> Self {
        Self(Sha256::digest(bytes).into())
    }
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
            from,
            topic,
            name,
            encoding,
            size_bytes,
            ..
        } = self;
        write!(
            f,
            "Offer({from}/{topic}, {name:?}, {encoding}, {size_bytes} bytes)"
        )
    }
}

/// One for the tests of this folder.
#[cfg(test)]
pub(super) fn sample(size_bytes: u64) -> Offer {
    Offer {
        from: Name::new("wombat-1").expect("a name"),
        topic: Topic::new("map/kitchen").expect("a topic"),
        name: FileName::new("kitchen.pcd").expect("a file's name"),
        encoding: Encoding::BYTES,
        size_bytes,
        checksum: Checksum::of(b"abc"),
        call: 7,
    }
}

#[cfg(test)]
mod tests;
