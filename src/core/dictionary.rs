//! Owns dictionaries: what many small messages have in common, kept once at both ends instead of sent with each.
//!
//! A [`Dictionary`] is a standard zstd one. Its id is made from its content, so that the same content has the same id
//! everywhere, and frames name it in two bytes: `32768 + crc32(all after the id) mod 32768`. A dictionary that another
//! program made gets that id, too; [`Dictionary::write`] writes it so that `zstd -D` reads RECT's frames.
use std::{
    collections::{BTreeMap, VecDeque},
    fmt,
    io::{self, Read},
    path::{Path, PathBuf},
    sync::Arc,
};

use zstd::zstd_safe::{self, CDict, DDict};

use super::name::Name;

/// The largest dictionary, in bytes: larger ones help no more, and each takes up to ten times as much memory.
pub const MAX_BYTES: usize = 128 << 10;
/// The smallest that training may make, in bytes.
pub const MIN_BYTES: usize = 512;
/// The most of the samples that training looks at, in bytes.
pub const MAX_SAMPLE_BYTES: usize = 64 << 20;

const MAGIC: [u8; 4] = [0x37, 0xA4, 0x30, 0xEC];
/// The magic number and the id.
const HEAD_BYTES: usize = 8;
const LOWEST_ID: u32 = 0x8000;
/// Higher ones gain a hundredth of small messages, for ten times the time.
const LEVEL: i32 = 3;

/// What many messages have in common.
pub struct Dictionary {
    bytes: Vec<u8>,
    id: u32,
    prepared: Prepared,
}

/// The dictionary as zstd wants it: made once, used for every message.
pub(super) struct Prepared {
    compress: CDict<'static>,
    decompress: DDict<'static>,
}

/// It can't be a dictionary, or can't be had.
#[derive(Debug, thiserror::Error)]
pub enum DictionaryError {
    /// Not a zstd dictionary.
    #[error("this is no zstd dictionary: {0}")]
    Damaged(&'static str),
    /// Too large.
    #[error("a dictionary may have {MAX_BYTES} bytes, and this one has more")]
    TooLarge,
    /// A size out of the range.
    #[error("a dictionary may be made {MIN_BYTES} to {MAX_BYTES} bytes large, not {0}")]
    Size(usize),
    /// Too few or too uniform samples. Some hundred real messages are wanted, ten times the dictionary's size together.
    #[error("{samples} samples of {bytes} bytes together make no dictionary ({reason}): give more, and different ones")]
    Samples {
        /// How many there were.
        samples: usize,
        /// How large they were together.
        bytes: usize,
        /// What zstd says.
        reason: &'static str,
    },
    /// Another dictionary has the same id, which one pair in 32768 has: train it anew, with other samples.
    #[error("there is another dictionary with the id {0}: train it anew, with other samples")]
    Taken(u32),
    /// The file can't be read or written.
    #[error("the dictionary {}: {source}", path.display())]
    File {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl Dictionary {
    /// Reads a zstd dictionary. Its id becomes the one that its content has here.
    ///
    /// # Errors
    /// [`DictionaryError::Damaged`], [`DictionaryError::TooLarge`].
    pub fn new(bytes: impl Into<Vec<u8>>) -> Result<Self, DictionaryError> {
        let mut bytes = bytes.into();
        if bytes.len() > MAX_BYTES {
            return Err(DictionaryError::TooLarge);
        }
        if !bytes.starts_with(&MAGIC) || bytes.len() <= HEAD_BYTES {
            let reason = "it does not begin as one does";
            return Err(DictionaryError::Damaged(reason));
        }
        let id = LOWEST_ID + (crc32fast::hash(&bytes[HEAD_BYTES..]) & (LOWEST_ID - 1));
        bytes[MAGIC.len()..HEAD_BYTES].copy_from_slice(&id.to_le_bytes());
        let prepared =
            Prepared::new(&bytes).ok_or(DictionaryError::Damaged("zstd can't read its tables"))?;
        Ok(Self {
            bytes,
            id,
            prepared,
        })
    }

    /// Makes one, at most `size` bytes large, of messages like those to come: 4 to 16 kB is good for JSON.
    ///
    /// # Errors
    /// [`DictionaryError::Size`], [`DictionaryError::Samples`].
    pub fn train<S: AsRef<[u8]>>(samples: &[S], size: usize) -> Result<Self, DictionaryError> {
        if !(MIN_BYTES..=MAX_BYTES).contains(&size) {
            return Err(DictionaryError::Size(size));
        }
        let mut all = Vec::new();
        let mut sizes = Vec::new();
        let samples = samples.iter().map(AsRef::as_ref);
        for sample in samples.filter(|sample| !sample.is_empty()) {
            if all.len() + sample.len() > MAX_SAMPLE_BYTES {
                break;
            }
            all.extend_from_slice(sample);
            sizes.push(sample.len());
        }
        let refused = |reason| DictionaryError::Samples {
            samples: sizes.len(),
            bytes: all.len(),
            reason,
        };
        // zstd learns from three quarters, tries on the rest, and reads beyond the end of less than a few bytes.
        let learned: usize = sizes[..sizes.len() / 4 * 3].iter().sum();
        if learned < MIN_BYTES {
            return Err(refused("too few"));
        }
        let mut bytes = Vec::with_capacity(size);
        zstd_safe::train_from_buffer(&mut bytes, &all, &sizes)
            .map_err(|code| refused(zstd_safe::get_error_name(code)))?;
        Self::new(bytes)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`DictionaryError::File`], and what [`Dictionary::new`] says of its bytes.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, DictionaryError> {
        let path = path.as_ref();
        let mut bytes = Vec::new();
        std::fs::File::open(path)
            .and_then(|file| file.take(MAX_BYTES as u64 + 1).read_to_end(&mut bytes))
            .map_err(|source| file_error(path, source))?;
        Self::new(bytes)
    }

    /// Writes a file, which the `zstd` command reads, too.
    ///
    /// # Errors
    /// [`DictionaryError::File`].
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), DictionaryError> {
        let path = path.as_ref();
        std::fs::write(path, &self.bytes).map_err(|source| file_error(path, source))
    }

    /// What frames call it, 32768 to 65535.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// The standard zstd dictionary.
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }
}

impl fmt::Debug for Dictionary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Dictionary({}, {} bytes)", self.id, self.bytes.len())
    }
}

impl Dictionary {
    pub(super) fn prepared(&self) -> &Prepared {
        &self.prepared
    }
}

impl Prepared {
    fn new(bytes: &[u8]) -> Option<Self> {
        Some(Self {
            compress: CDict::try_create(bytes, LEVEL)?,
            decompress: DDict::try_create(bytes)?,
        })
    }

    pub(super) fn compress(&self) -> &CDict<'static> {
        &self.compress
    }

    pub(super) fn decompress(&self) -> &DDict<'static> {
        &self.decompress
    }
}

fn file_error(path: &Path, source: io::Error) -> DictionaryError {
    let path = path.to_owned();
    DictionaryError::File { path, source }
}

/// The dictionaries that are known here, at most [`Dictionaries::MOST`]: one more, and the one that came first is
/// forgotten. Cloning shares the dictionaries themselves.
#[derive(Clone, Debug, Default)]
pub struct Dictionaries(VecDeque<Arc<Dictionary>>);

impl Dictionaries {
    /// How many are kept.
    pub const MOST: usize = 16;

    /// This one alone.
    pub fn of(dictionary: Arc<Dictionary>) -> Self {
        Self([dictionary].into())
    }

    /// Adds one; one that is there already changes nothing.
    ///
    /// # Errors
    /// [`DictionaryError::Taken`].
    pub fn add(&mut self, dictionary: Arc<Dictionary>) -> Result<(), DictionaryError> {
        match self.get(dictionary.id) {
            Some(same) if same.bytes == dictionary.bytes => return Ok(()),
            Some(_) => return Err(DictionaryError::Taken(dictionary.id)),
            None => {}
        }
        if self.0.len() == Self::MOST {
            self.0.pop_front();
        }
        self.0.push_back(dictionary);
        Ok(())
    }

    /// The one that frames call so.
    pub fn get(&self, id: u32) -> Option<&Arc<Dictionary>> {
        self.0.iter().find(|dictionary| dictionary.id == id)
    }

    /// All, the oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &Arc<Dictionary>> {
        self.0.iter()
    }
}

/// The dictionaries of several robots. Each robot's messages are unpacked with that robot's own dictionaries: an id of two
/// bytes is easily found for other content, so that one robot could change or spoil what is read of another's messages.
#[derive(Debug, Default)]
pub struct RobotDictionaries(BTreeMap<Name, Dictionaries>);

impl RobotDictionaries {
    /// How many are kept of all robots together; of one robot, [`Dictionaries::MOST`].
    pub const MOST: usize = 64;

    /// The dictionaries of that robot.
    pub fn of(&self, robot: &Name) -> &Dictionaries {
        static NONE: Dictionaries = Dictionaries(VecDeque::new());
        self.0.get(robot).unwrap_or(&NONE)
    }

    /// Adds one of that robot's, in place of one with the same id. With too many, the robot that has most loses its oldest.
    pub fn add(&mut self, robot: &Name, dictionary: Arc<Dictionary>) {
        let known = self.0.entry(robot.clone()).or_default();
        known.0.retain(|known| known.id != dictionary.id);
        if known.0.len() == Dictionaries::MOST {
            known.0.pop_front();
        }
        known.0.push_back(dictionary);
        while self.len() > Self::MOST {
            let most = self.0.values_mut().max_by_key(|known| known.0.len());
            most.and_then(|known| known.0.pop_front());
            self.0.retain(|_, known| !known.0.is_empty());
        }
    }

    fn len(&self) -> usize {
        self.0.values().map(|known| known.0.len()).sum()
    }
}

#[cfg(test)]
mod tests;
