//! Owns where a transfer that comes is kept: in memory, or in a part file with a [`Record`] beside it, which becomes the
//! file once all is there.
//!
//! In `<folder>/<sender>/`: `.<id>.part` and `.<id>.record`, then `<name>`, which replaces one that is there. What is of no
//! more use is removed: a part that nothing was added to, or that cannot be finished, and an empty folder. A process that is
//! killed leaves its files behind; [`Store::clean`] removes those that no transfer can go on with.
use std::{
    fs::{self, File, OpenOptions},
    io::{self, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, SystemTime},
};

use bytes::Bytes;

use super::checksum;
use crate::core::transfer::{
    ranges::Ranges,
    record::{Record, MAX_BYTES as MAX_RECORD_BYTES},
    Checksum, Fault, Offer, TransferId,
};

/// How long a part is kept that nothing was added to.
const KEPT: Duration = Duration::from_secs(7 * 24 * 3600);
/// How long a file is left alone that no transfer can go on with: another program may be about to finish it.
const LEFT: Duration = Duration::from_secs(60);
/// How many interrupted transfers of one sender are kept: of more, the oldest are removed.
const MAX_KEPT: usize = 16;
const PART: &str = "part";
const RECORD: &str = "record";
/// A record that is being written.
const NEW: &str = "new";

/// Where what comes is kept.
#[derive(Debug)]
pub enum Store {
    /// In memory.
    Memory(Vec<u8>),
    /// In a file.
    File(Box<PartFile>),
}

/// A file that grows.
#[derive(Debug)]
pub struct PartFile {
    file: File,
    part: PathBuf,
    record: PathBuf,
    whole: PathBuf,
    offer: Offer,
    in_use: InUse,
}

/// Keeps a part from being removed while a transfer of this process has it.
#[derive(Debug)]
struct InUse(PathBuf);

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
        let new = part.record.with_extension(NEW);
        let written =
            fs::write(&new, record.encode()).and_then(|()| fs::rename(&new, &part.record));
        if written.is_err() {
            let _ = fs::remove_file(&new);
        }
        written
    }

    /// The transfer has ended with this fault. Keeps what is there if the transfer can go on later, and nothing else.
    ///
    /// # Errors
    /// Removes a part that cannot be kept.
    pub fn interrupt(self, held: &Ranges, fault: &Fault) -> io::Result<()> {
        let is_of_use = match fault {
            // Nothing of it is right, or never will be.
            Fault::Checksum | Fault::Protocol(_) | Fault::Changed(_) => false,
            // It would keep smaller transfers from having the room.
            Fault::NotKept(_) => false,
            Fault::Silence(_) | Fault::Stopped | Fault::Unreadable(_) => held.bytes() > 0,
        };
        let kept = if is_of_use { self.save(held) } else { Ok(()) };
        if !is_of_use || kept.is_err() {
            self.discard();
        }
        kept
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
    /// The file can't get its name. What came is removed.
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

    /// It is of no use any more.
    pub fn discard(self) {
        if let Self::File(part) = self {
            // Where a taker was closed and the next one has begun, that one goes on with it.
            if part.in_use.is_alone() {
                remove(&part.part);
            }
            if let Some(folder) = part.part.parent() {
                // Only an empty one goes.
                let _ = fs::remove_dir(folder);
            }
        }
    }

    /// Removes what a process that was killed has left in that folder and no transfer can go on with, parts that nothing
    /// was added to for a week, and empty folders.
    pub fn clean(folder: &Path, now: SystemTime) {
        for sender in entries(folder) {
            for file in entries(&sender.path()) {
                let path = file.path();
                if is_of_no_use(&path, now) {
                    remove(&path);
                }
            }
            // Only an empty one goes, and no file.
            let _ = fs::remove_dir(sender.path());
        }
    }
}

/// Whether it is a file of ours, in use by nobody, that no transfer can go on with.
fn is_of_no_use(path: &Path, now: SystemTime) -> bool {
    let part = path.with_extension(PART);
    let is_meant = match our_kind(path) {
        Some(PART) if read_record(&path.with_extension(RECORD)).is_some() => {
            is_older(path, now, KEPT)
        }
        Some(RECORD) => !part.exists() && is_older(path, now, LEFT),
        Some(PART | NEW) => is_older(path, now, LEFT),
        _ => false,
    };
    is_meant && !InUse::has(&part)
}

/// The last part of the name of a file that belongs to a transfer that is not finished.
fn our_kind(path: &Path) -> Option<&str> {
    let id = path.file_stem()?.to_str()?.strip_prefix('.')?;
    let is_id = id.len() == 16 && id.bytes().all(|byte| byte.is_ascii_hexdigit());
    path.extension()?.to_str().filter(|_| is_id)
}

fn is_older(path: &Path, now: SystemTime, age: Duration) -> bool {
    let written = fs::metadata(path).and_then(|metadata| metadata.modified());
    written.is_ok_and(|at| now.duration_since(at).is_ok_and(|passed| passed > age))
}

/// Removes the part of that name, or one of its files, with all that belongs to it.
fn remove(path: &Path) {
    for kind in [PART, RECORD, NEW] {
        let _ = fs::remove_file(path.with_extension(kind));
    }
}

/// Removes the oldest interrupted transfers of a sender, so that a new one makes no more than there may be.
fn limit(folder: &Path) {
    let written = |path: &Path| fs::metadata(path).and_then(|metadata| metadata.modified());
    let parts = entries(folder).map(|file| file.path());
    let parts = parts.filter(|path| our_kind(path) == Some(PART) && !InUse::has(path));
    let mut parts: Vec<_> = parts.map(|path| (written(&path).ok(), path)).collect();
    parts.sort();
    let too_many = (parts.len() + 1).saturating_sub(MAX_KEPT);
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

    /// Whether nobody else has it.
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

/// Opens the part, and makes the folder for it; another transfer's end may remove that in between.
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
