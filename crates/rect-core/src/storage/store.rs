//! Stores the data of an incoming transfer: in memory, or in a part file with a [`Record`] beside it, which is renamed
//! when the transfer is complete.
//!
//! The files in `<folder>/<sender>/` are `.<id>.part` and `.<id>.record`, and finally `<name>`, which replaces an
//! existing file of that name. Files that are no longer useful are removed: a part that is empty or cannot be finished,
//! and an empty folder. If a process is killed, its files stay; [`Store::clean`] removes those with which no transfer
//! can continue.
use std::{
    fs::{self, File, OpenOptions},
    io::{self, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, SystemTime},
};

use bytes::Bytes;

use super::checksum;
use crate::transfer::{
    ranges::Ranges,
    record::{Record, MAX_BYTES as MAX_RECORD_BYTES},
    Checksum, Fault, Offer, TransferId,
};

/// How long a part that does not grow is kept.
const PART_LIFETIME: Duration = Duration::from_secs(7 * 24 * 3600);
/// How long a file with which no transfer can continue is kept, because another program may be about to finish it.
const USELESS_LIFETIME: Duration = Duration::from_secs(60);
/// The maximum number of interrupted transfers of one sender. Beyond it, the oldest are removed.
const MAX_INTERRUPTED: usize = 16;
const PART: &str = "part";
const RECORD: &str = "record";
/// A record that is being written.
const NEW: &str = "new";

/// The storage of an incoming transfer.
#[derive(Debug)]
pub enum Store {
    /// In memory.
    Memory(Vec<u8>),
    /// In a part file.
    File(Box<PartFile>),
}

/// A part file.
#[derive(Debug)]
pub struct PartFile {
    file: File,
    part: PathBuf,
    record: PathBuf,
    /// The path of the complete file.
    whole: PathBuf,
    offer: Offer,
    in_use: InUse,
}

/// Protects a part from being removed while a transfer of this process uses it.
#[derive(Debug)]
struct InUse(PathBuf);

/// The data of a complete transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Content {
    /// Bytes in memory.
    Bytes(Bytes),
    /// The path of a file.
    File(PathBuf),
}

impl Store {
    /// Creates a store in memory. The memory is reserved now, but used only as data arrives.
    ///
    /// # Errors
    /// Returns an error if there is not enough memory.
    pub fn in_memory(size_bytes: u64) -> io::Result<Self> {
        let too_large = || io::Error::new(io::ErrorKind::OutOfMemory, "not enough memory");
        let mut bytes = Vec::new();
        let size = usize::try_from(size_bytes).map_err(|_| too_large())?;
        bytes.try_reserve_exact(size).map_err(|_| too_large())?;
        Ok(Self::Memory(bytes))
    }

    /// Creates a store in a folder. Returns it with the ranges that are present from before an interruption.
    ///
    /// # Errors
    /// Returns an error if the folder cannot be created or written to.
    pub fn in_folder(folder: &Path, id: TransferId, offer: &Offer) -> io::Result<(Self, Ranges)> {
        let folder = folder.join(offer.sender.as_str());
        let name = match offer.name.as_str() {
            "" => id.to_string(),
            name => name.to_owned(),
        };
        let part = folder.join(format!(".{id}.{PART}"));
        let record = part.with_extension(RECORD);
        let in_use = InUse::new(&part);
        limit(&folder);
        let known = read_record(&record).filter(|known| known.offer.is_same(offer));
        let file = open_part(&folder, &part)?;
        let known =
            known.filter(|known| file.metadata().is_ok_and(|m| m.len() >= known.held.end()));
        if known.is_none() {
            file.set_len(0)?;
        }
        let held = known.map(|known| known.held).unwrap_or_default();
        let whole = folder.join(name);
        let offer = offer.clone();
        Ok((
            Self::File(Box::new(PartFile {
                file,
                part,
                record,
                whole,
                offer,
                in_use,
            })),
            held,
        ))
    }

    /// Writes bytes at an offset.
    ///
    /// # Errors
    /// Returns an error if the bytes cannot be written, for example because the disk is full.
    pub fn write(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Memory(all) => {
                let no_room = || io::Error::new(io::ErrorKind::OutOfMemory, "not enough memory");
                let start = usize::try_from(at).map_err(|_| no_room())?;
                let end = start.checked_add(bytes.len()).ok_or_else(no_room)?;
                if all.len() < end {
                    // Never exceeds the reserved memory, even if a sender does not keep to the announced size.
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

    /// Saves the state for a restart. The data is flushed to the disk before the record of it is written.
    ///
    /// # Errors
    /// Returns an error if the record cannot be written, for example because the disk is full.
    pub fn save(&self, held: &Ranges) -> io::Result<()> {
        let Self::File(part) = self else {
            return Ok(());
        };
        part.file.sync_data()?;
        let record = Record {
            offer: part.offer.clone(),
            held: held.clone(),
        };
        let new = part.record.with_extension(NEW);
        let written =
            fs::write(&new, record.encode()).and_then(|()| fs::rename(&new, &part.record));
        if written.is_err() {
            let _ = fs::remove_file(&new);
        }
        written
    }

    /// Ends the transfer with a fault. Keeps the part if the transfer can continue later, and removes it otherwise.
    ///
    /// # Errors
    /// Returns an error if the state cannot be saved; then the part is removed.
    pub fn interrupt(self, held: &Ranges, fault: &Fault) -> io::Result<()> {
        let is_useful = match fault {
            // The data is wrong, or the source no longer matches the offer.
            Fault::Checksum | Fault::Protocol(_) | Fault::Changed(_) => false,
            // The part would take the disk space that smaller transfers need.
            Fault::NotStored(_) => false,
            Fault::TimedOut(_) | Fault::Stopped | Fault::Unreadable(_) => held.bytes() > 0,
        };
        let kept = if is_useful { self.save(held) } else { Ok(()) };
        if !is_useful || kept.is_err() {
            self.discard();
        }
        kept
    }

    /// Computes the checksum. The file is read again, so that the check covers what is on the disk.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read.
    pub fn checksum(&mut self) -> io::Result<Checksum> {
        match self {
            Self::Memory(all) => Ok(Checksum::of(all)),
            Self::File(part) => {
                // A part from before a restart may be too long.
                part.file.set_len(part.offer.size_bytes)?;
                part.file.seek(SeekFrom::Start(0))?;
                Ok(checksum(&mut part.file)?.0)
            }
        }
    }

    /// Finishes a complete and verified transfer: returns the bytes, or renames the part file.
    ///
    /// # Errors
    /// Returns an error if the file cannot be renamed; then the part is removed.
    pub fn finish(self) -> io::Result<Content> {
        match self {
            Self::Memory(all) => Ok(Content::Bytes(all.into())),
            Self::File(part) => {
                let renamed = part.file.sync_all();
                let renamed = renamed.and_then(|()| fs::rename(&part.part, &part.whole));
                match renamed {
                    Ok(()) => {
                        let _ = fs::remove_file(&part.record);
                        Ok(Content::File(part.whole))
                    }
                    Err(error) => {
                        Self::File(part).discard();
                        Err(error)
                    }
                }
            }
        }
    }

    /// Removes the data of a transfer that cannot continue.
    pub fn discard(self) {
        if let Self::File(part) = self {
            // If a receiver was closed and the next one has begun, the next one continues with the part.
            if part.in_use.is_alone() {
                remove(&part.part);
            }
            if let Some(folder) = part.part.parent() {
                // Removes only an empty folder.
                let _ = fs::remove_dir(folder);
            }
        }
    }

    /// Removes the files of killed processes with which no transfer can continue, parts that have not grown for a week,
    /// and empty folders.
    pub fn clean(folder: &Path, now: SystemTime) {
        for sender in entries(folder) {
            for file in entries(&sender.path()) {
                let path = file.path();
                if is_useless(&path, now) {
                    remove(&path);
                }
            }
            // Removes only an empty folder, and no file.
            let _ = fs::remove_dir(sender.path());
        }
    }
}

/// Returns whether the file belongs to a transfer, is not in use, and no transfer can continue with it.
fn is_useless(path: &Path, now: SystemTime) -> bool {
    let part = path.with_extension(PART);
    let is_candidate = match transfer_extension(path) {
        Some(PART) if read_record(&path.with_extension(RECORD)).is_some() => {
            is_older(path, now, PART_LIFETIME)
        }
        Some(RECORD) => !part.exists() && is_older(path, now, USELESS_LIFETIME),
        Some(PART | NEW) => is_older(path, now, USELESS_LIFETIME),
        _ => false,
    };
    is_candidate && !InUse::has(&part)
}

/// Returns the extension of a file that belongs to an unfinished transfer.
fn transfer_extension(path: &Path) -> Option<&str> {
    let id = path.file_stem()?.to_str()?.strip_prefix('.')?;
    let is_id = id.len() == 16 && id.bytes().all(|byte| byte.is_ascii_hexdigit());
    path.extension()?.to_str().filter(|_| is_id)
}

fn is_older(path: &Path, now: SystemTime, age: Duration) -> bool {
    let written = fs::metadata(path).and_then(|metadata| metadata.modified());
    written.is_ok_and(|at| now.duration_since(at).is_ok_and(|passed| passed > age))
}

/// Removes all files of a part.
fn remove(path: &Path) {
    for kind in [PART, RECORD, NEW] {
        let _ = fs::remove_file(path.with_extension(kind));
    }
}

/// Removes the oldest interrupted transfers of a sender, to make room for a new one.
fn limit(folder: &Path) {
    let written = |path: &Path| fs::metadata(path).and_then(|metadata| metadata.modified());
    let parts = entries(folder).map(|file| file.path());
    let parts = parts.filter(|path| transfer_extension(path) == Some(PART) && !InUse::has(path));
    let mut parts: Vec<_> = parts.map(|path| (written(&path).ok(), path)).collect();
    parts.sort();
    let too_many = (parts.len() + 1).saturating_sub(MAX_INTERRUPTED);
    parts
        .iter()
        .take(too_many)
        .for_each(|(_, path)| remove(path));
}

impl InUse {
    fn new(part: &Path) -> Self {
        Self::all().push(part.to_owned());
        Self(part.to_owned())
    }

    fn has(part: &Path) -> bool {
        Self::all().iter().any(|known| known == part)
    }

    /// Returns whether no other transfer uses the part.
    fn is_alone(&self) -> bool {
        Self::all().iter().filter(|known| **known == self.0).count() == 1
    }

    fn all() -> MutexGuard<'static, Vec<PathBuf>> {
        static PARTS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
        PARTS.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for InUse {
    fn drop(&mut self) {
        let mut all = Self::all();
        if let Some(at) = all.iter().position(|known| *known == self.0) {
            all.swap_remove(at);
        }
    }
}

/// Opens the part and creates its folder, which the end of another transfer may remove in between.
fn open_part(folder: &Path, part: &Path) -> io::Result<File> {
    let mut tries = 0;
    loop {
        fs::create_dir_all(folder)?;
        let opened = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(part);
        match opened {
            Err(error) if error.kind() == io::ErrorKind::NotFound && tries < 10 => tries += 1,
            opened => return opened,
        }
    }
}

fn entries(path: &Path) -> impl Iterator<Item = fs::DirEntry> {
    fs::read_dir(path).into_iter().flatten().flatten()
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
