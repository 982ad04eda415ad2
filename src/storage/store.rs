//! Owns where a transfer that comes is kept: in memory, or in a part file with a [`Record`] beside it, which becomes the
//! file once all is there.
//!
//! In `<folder>/<sender>/`: `.<id>.part` and `.<id>.record`, then `<name>`, which replaces one that is there.
use std::{
    fs::{self, File, OpenOptions},
    io::{self, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use bytes::Bytes;

use super::checksum;
use crate::core::transfer::{
    ranges::Ranges,
    record::{Record, MAX_BYTES as MAX_RECORD_BYTES},
    Checksum, Offer, TransferId,
};

/// How long a part is kept that nothing was added to.
const KEPT: Duration = Duration::from_secs(7 * 24 * 3600);

/// Where what comes is kept.
#[derive(Debug)]
pub enum Store {
    /// In memory.
    Memory(Vec<u8>),
    /// In a file.
    File(PartFile),
}

/// A file that grows.
#[derive(Debug)]
pub struct PartFile {
    file: File,
    part: PathBuf,
    record: PathBuf,
    whole: PathBuf,
    offer: Offer,
}

/// What came.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Content {
    /// In memory.
    Bytes(Bytes),
    /// In this file.
    File(PathBuf),
}

impl Store {
    /// In memory, which is used as it comes.
    ///
    /// # Errors
    /// There is not as much.
    pub fn in_memory(size_bytes: u64) -> io::Result<Self> {
        let too_large = || io::Error::new(io::ErrorKind::OutOfMemory, "not enough memory");
        let mut bytes = Vec::new();
        let size = usize::try_from(size_bytes).map_err(|_| too_large())?;
        bytes.try_reserve_exact(size).map_err(|_| too_large())?;
        Ok(Self::Memory(bytes))
    }

    /// In a file, and what of it is there from before.
    ///
    /// # Errors
    /// The folder can't be made or written to.
    pub fn in_folder(folder: &Path, id: TransferId, offer: &Offer) -> io::Result<(Self, Ranges)> {
        let folder = folder.join(offer.from.as_str());
        fs::create_dir_all(&folder)?;
        let name = match offer.name.as_str() {
            "" => id.to_string(),
            name => name.to_owned(),
        };
        let (part, record) = (
            folder.join(format!(".{id}.part")),
            folder.join(format!(".{id}.record")),
        );
        let known = read_record(&record).filter(|known| known.offer.is_same(offer));
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&part)?;
        let known =
            known.filter(|known| file.metadata().is_ok_and(|m| m.len() >= known.held.end()));
        if known.is_none() {
            file.set_len(0)?;
        }
        let held = known.map(|known| known.held).unwrap_or_default();
        let whole = folder.join(name);
        let offer = offer.clone();
        Ok((
            Self::File(PartFile {
                file,
                part,
                record,
                whole,
                offer,
            }),
            held,
        ))
    }

    /// Puts bytes where they belong.
    ///
    /// # Errors
    /// The disk is full, for example.
    pub fn write(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Memory(all) => {
                let no_room = || io::Error::new(io::ErrorKind::OutOfMemory, "not enough memory");
                let start = usize::try_from(at).map_err(|_| no_room())?;
                let end = start.checked_add(bytes.len()).ok_or_else(no_room)?;
                if all.len() < end {
                    // No more than was reserved: a size that is not kept to does not get further memory.
                    if end > all.capacity() {
                        return Err(no_room());
                    }
                    all.resize(end, 0);
                }
                all.get_mut(start..end)
                    .ok_or_else(no_room)?
                    .copy_from_slice(bytes);
                Ok(())
            }
            Self::File(part) => {
                part.file.seek(SeekFrom::Start(at))?;
                part.file.write_all(bytes)
            }
        }
    }

    /// Remembers what is there, for a restart: first the bytes reach the disk, then the record of them.
    ///
    /// # Errors
    /// The disk is full, for example.
    pub fn save(&self, held: &Ranges) -> io::Result<()> {
        let Self::File(part) = self else {
            return Ok(());
        };
        part.file.sync_data()?;
        let record = Record {
            offer: part.offer.clone(),
            held: held.clone(),
        };
        let new = part.record.with_extension("new");
        fs::write(&new, record.encode())?;
        fs::rename(&new, &part.record)
    }

    /// What all that is there comes to. Reads the file anew: what counts is what is on the disk.
    ///
    /// # Errors
    /// It can't be read.
    pub fn checksum(&mut self) -> io::Result<Checksum> {
        match self {
            Self::Memory(all) => Ok(Checksum::of(all)),
            Self::File(part) => {
                // A part from before a restart may be longer than it was to be.
                part.file.set_len(part.offer.size_bytes)?;
                part.file.seek(SeekFrom::Start(0))?;
                Ok(checksum(&mut part.file)?.0)
            }
        }
    }

    /// All is there, and right.
    ///
    /// # Errors
    /// The file can't get its name.
    pub fn finish(self) -> io::Result<Content> {
        match self {
            Self::Memory(all) => Ok(Content::Bytes(all.into())),
            Self::File(part) => {
                part.file.sync_all()?;
                fs::rename(&part.part, &part.whole)?;
                let _ = fs::remove_file(&part.record);
                Ok(Content::File(part.whole))
            }
        }
    }

    /// It is of no use any more.
    pub fn discard(self) {
        if let Self::File(part) = self {
            let _ = fs::remove_file(&part.part);
            let _ = fs::remove_file(&part.record);
        }
    }

    /// Removes the parts in that folder that nothing was added to for a week.
    pub fn clean(folder: &Path, now: SystemTime) {
        let entries = |path: &Path| fs::read_dir(path).into_iter().flatten().flatten();
        for file in entries(folder).flat_map(|robot| entries(&robot.path()).collect::<Vec<_>>()) {
            let name = file.file_name();
            let name = name.to_string_lossy();
            let ours =
                name.starts_with('.') && (name.ends_with(".part") || name.ends_with(".record"));
            let written = file.metadata().and_then(|metadata| metadata.modified());
            let old = written.is_ok_and(|at| now.duration_since(at).is_ok_and(|age| age > KEPT));
            if ours && old {
                let _ = fs::remove_file(file.path());
            }
        }
    }
}

fn read_record(path: &Path) -> Option<Record> {
    let length = fs::metadata(path).ok()?.len();
    if length > MAX_RECORD_BYTES as u64 {
        return None;
    }
    Record::decode(&fs::read(path).ok()?)
}

#[cfg(test)]
mod tests;
