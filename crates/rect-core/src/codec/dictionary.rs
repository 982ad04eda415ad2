//! Trains and stores dictionaries: the content that many small messages have in common is kept at both ends instead of
//! being sent with each message.
//!
//! A [`Dictionary`] is a standard zstd dictionary. Its id is derived from its content, so that equal content has the
//! same id everywhere: `32768 + (crc32(everything after the id) mod 32768)`. Frames refer to it in two bytes. A
//! dictionary that another program made is assigned that id, too; [`Dictionary::write`] writes it in a form with which
//! `zstd -D` decompresses RECT's frames.
use std::{
    collections::{BTreeMap, VecDeque},
    fmt,
    io::{self, Read, Write},
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
    sync::Arc,
};

use zstd::zstd_safe::{self, CDict, DDict};

use crate::name::Name;

/// The maximum size of a dictionary, in bytes. Larger ones do not compress better, and each takes up to ten times its
/// size in memory.
pub const MAX_BYTES: usize = 128 << 10;
/// The minimum size that training accepts, in bytes.
pub const MIN_BYTES: usize = 512;
/// The maximum amount of samples that training reads, in bytes.
pub const MAX_SAMPLE_BYTES: usize = 64 << 20;

/// The permissions of a new file: its owner writes, and its group reads it.
const MODE: u32 = 0o640;
const MAGIC: [u8; 4] = [0x37, 0xA4, 0x30, 0xEC];
/// The length of the magic number and the id.
const HEAD_BYTES: usize = 8;
const LOWEST_ID: u32 = 0x8000;
/// The compression level. Higher ones make small messages one percent smaller, in ten times the time.
const LEVEL: i32 = 3;

/// A zstd dictionary for messages of similar content.
pub struct Dictionary {
    bytes: Vec<u8>,
    id: u32,
    prepared: Prepared,
}

/// The dictionary in zstd's internal form, which is computed once and used for every message.
pub(super) struct Prepared {
    compress: CDict<'static>,
    decompress: DDict<'static>,
}

/// A dictionary cannot be read, trained or stored.
#[derive(Debug, thiserror::Error)]
pub enum DictionaryError {
    /// The bytes are not a zstd dictionary.
    #[error("not a zstd dictionary: {0}")]
    Damaged(&'static str),
    /// The dictionary is larger than [`MAX_BYTES`].
    #[error("the dictionary is too large: at most {MAX_BYTES} bytes are allowed")]
    TooLarge,
    /// The requested size is out of range.
    #[error("the size of a dictionary must be {MIN_BYTES} to {MAX_BYTES} bytes, not {0}")]
    Size(usize),
    /// There are too few samples, or they are too uniform. Use several hundred real messages whose total size is ten
    /// times that of the dictionary.
    #[error("cannot train a dictionary on {samples} samples of {bytes} bytes in total ({reason}): use more samples, and more varied ones")]
    Samples {
        /// The number of samples.
        samples: usize,
        /// Their total size, in bytes.
        bytes: usize,
        /// The reason that zstd reports.
        reason: &'static str,
    },
    /// Another dictionary has the same id, which happens by chance for one pair in 32768. Train the dictionary again
    /// with other samples.
    #[error("another dictionary has the id {0}: train it again, with other samples")]
    IdTaken(u32),
    /// The file cannot be read or written.
    #[error("the dictionary {}: {source}", path.display())]
    File {
        /// The path of the file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

impl Dictionary {
    /// Creates a dictionary from the bytes of a zstd dictionary, and replaces its id by the one derived from its
    /// content.
    ///
    /// # Errors
    /// Returns [`DictionaryError::Damaged`] or [`DictionaryError::TooLarge`].
    pub fn new(bytes: impl Into<Vec<u8>>) -> Result<Self, DictionaryError> {
        let mut bytes = bytes.into();
        if bytes.len() > MAX_BYTES {
            return Err(DictionaryError::TooLarge);
        }
        if !bytes.starts_with(&MAGIC) || bytes.len() <= HEAD_BYTES {
            let reason = "it does not begin with the magic number";
            return Err(DictionaryError::Damaged(reason));
        }
        let id = LOWEST_ID + (crc32fast::hash(&bytes[HEAD_BYTES..]) & (LOWEST_ID - 1));
        bytes[MAGIC.len()..HEAD_BYTES].copy_from_slice(&id.to_le_bytes());
        let prepared =
            Prepared::new(&bytes).ok_or(DictionaryError::Damaged("zstd cannot read its tables"))?;
        Ok(Self {
            bytes,
            id,
            prepared,
        })
    }

    /// Trains a dictionary of at most `size` bytes, [`MIN_BYTES`] to [`MAX_BYTES`], on messages like those that will be
    /// sent. For JSON, 4 to 16 kB is a good size. Samples beyond a total of [`MAX_SAMPLE_BYTES`] are ignored.
    ///
    /// # Errors
    /// Returns [`DictionaryError::Size`] or [`DictionaryError::Samples`].
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
        let rejected = |reason| DictionaryError::Samples {
            samples: sizes.len(),
            bytes: all.len(),
            reason,
        };
        // zstd trains on three quarters of the samples and tests on the rest. It reads out of bounds if the former have
        // only a few bytes.
        let learned: usize = sizes[..sizes.len() / 4 * 3].iter().sum();
        if learned < MIN_BYTES {
            return Err(rejected("too few"));
        }
        let mut bytes = Vec::with_capacity(size);
        zstd_safe::train_from_buffer(&mut bytes, &all, &sizes)
            .map_err(|code| rejected(zstd_safe::get_error_name(code)))?;
        Self::new(bytes)
    }

    /// Reads a dictionary from a file.
    ///
    /// # Errors
    /// Returns [`DictionaryError::File`] if the file cannot be read, and the errors of [`Dictionary::new`].
    pub fn read(path: impl AsRef<Path>) -> Result<Self, DictionaryError> {
        let path = path.as_ref();
        let mut bytes = Vec::new();
        std::fs::File::open(path)
            .and_then(|file| file.take(MAX_BYTES as u64 + 1).read_to_end(&mut bytes))
            .map_err(|source| file_error(path, source))?;
        Self::new(bytes)
    }

    /// Writes the dictionary to a file, which the `zstd` command can also read.
    ///
    /// # Errors
    /// Returns [`DictionaryError::File`] if the file cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), DictionaryError> {
        let path = path.as_ref();
        let is_new = !path.exists();
        let mut options = std::fs::OpenOptions::new();
        let opened = options
            .write(true)
            .create(true)
            .truncate(true)
            .mode(MODE)
            .open(path);
        let written = opened.and_then(|mut file| {
            // Whatever the umask of the program is.
            if is_new {
                file.set_permissions(std::fs::Permissions::from_mode(MODE))?;
            }
            file.write_all(&self.bytes)
        });
        written.map_err(|source| file_error(path, source))
    }

    /// Returns the id by which frames refer to the dictionary, 32768 to 65535.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// Returns the bytes of the standard zstd dictionary.
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

/// The dictionaries that can be used for decoding, at most [`Dictionaries::MAX`]. Adding one more removes the oldest.
/// Clones share the dictionaries themselves.
#[derive(Clone, Debug, Default)]
pub struct Dictionaries(VecDeque<Arc<Dictionary>>);

impl Dictionaries {
    /// The maximum number of dictionaries.
    pub const MAX: usize = 16;

    /// Creates a collection with a single dictionary.
    pub fn of(dictionary: Arc<Dictionary>) -> Self {
        Self([dictionary].into())
    }

    /// Adds a dictionary. Adding one that is already present has no effect.
    ///
    /// # Errors
    /// Returns [`DictionaryError::IdTaken`] if another dictionary has the same id.
    pub fn add(&mut self, dictionary: Arc<Dictionary>) -> Result<(), DictionaryError> {
        match self.get(dictionary.id) {
            Some(same) if same.bytes == dictionary.bytes => return Ok(()),
            Some(_) => return Err(DictionaryError::IdTaken(dictionary.id)),
            None => {}
        }
        if self.0.len() == Self::MAX {
            self.0.pop_front();
        }
        self.0.push_back(dictionary);
        Ok(())
    }

    /// Returns the dictionary with the id `id`.
    pub fn get(&self, id: u32) -> Option<&Arc<Dictionary>> {
        self.0.iter().find(|dictionary| dictionary.id == id)
    }

    /// Returns all dictionaries, the oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &Arc<Dictionary>> {
        self.0.iter()
    }
}

/// The dictionaries of several robots. The messages of each robot are decoded with that robot's own dictionaries: an id
/// has only two bytes, so a robot could easily create a dictionary with the id of another one and falsify another
/// robot's messages.
#[derive(Debug, Default)]
pub struct RobotDictionaries(BTreeMap<Name, Dictionaries>);

impl RobotDictionaries {
    /// The maximum number of dictionaries of all robots together. For each robot it is [`Dictionaries::MAX`].
    pub const MAX: usize = 64;

    /// Returns the dictionaries of a robot.
    pub fn of(&self, robot: &Name) -> &Dictionaries {
        static NONE: Dictionaries = Dictionaries(VecDeque::new());
        self.0.get(robot).unwrap_or(&NONE)
    }

    /// Adds a dictionary of a robot, replacing one with the same id. If there are too many, the robot that has the
    /// most loses its oldest one.
    pub fn add(&mut self, robot: &Name, dictionary: Arc<Dictionary>) {
        let dictionaries = self.0.entry(robot.clone()).or_default();
        dictionaries.0.retain(|known| known.id != dictionary.id);
        if dictionaries.0.len() == Dictionaries::MAX {
            dictionaries.0.pop_front();
        }
        dictionaries.0.push_back(dictionary);
        while self.len() > Self::MAX {
            let largest = self
                .0
                .values_mut()
                .max_by_key(|dictionaries| dictionaries.0.len());
            largest.and_then(|dictionaries| dictionaries.0.pop_front());
            self.0.retain(|_, dictionaries| !dictionaries.0.is_empty());
        }
    }

    fn len(&self) -> usize {
        self.0
            .values()
            .map(|dictionaries| dictionaries.0.len())
            .sum()
    }
}

#[cfg(test)]
mod tests;
