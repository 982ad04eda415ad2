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
mod tests {
    use super::*;
    use crate::core::{encoding::Encoding, name::Name, topic::Topic, transfer::offer::FileName};

    fn offer(name: &str, bytes: &[u8]) -> (Offer, TransferId) {
        let offer = Offer {
            from: Name::new("wombat-1").expect("a name"),
            topic: Topic::new("map").expect("a topic"),
            name: FileName::new(name).expect("a file's name"),
            encoding: Encoding::BYTES,
            size_bytes: bytes.len() as u64,
            checksum: Checksum::of(bytes),
            call: 1,
        };
        let id = offer.id(&Name::new("wombat-2").expect("a name"));
        (offer, id)
    }

    fn held(range: std::ops::Range<u64>) -> Ranges {
        let mut held = Ranges::default();
        held.insert(range);
        held
    }

    #[test]
    fn what_was_saved_is_there_after_a_restart() {
        let folder = tempfile::tempdir().expect("a folder");
        let (offer, id) = offer("x.bin", b"abcdef");
        let (mut store, there) = Store::in_folder(folder.path(), id, &offer).expect("a store");
        assert_eq!(there, Ranges::default());
        store.write(0, b"abc").expect("room");
        store.save(&held(0..3)).expect("room");
        store.write(3, b"d").expect("room");
        drop(store);
        let again = Offer {
            call: 2,
            ..offer.clone()
        };
        let (mut store, there) = Store::in_folder(folder.path(), id, &again).expect("a store");
        assert_eq!(there, held(0..3));
        store.write(3, b"def").expect("room");
        assert_eq!(store.checksum().expect("read"), offer.checksum);
        let Content::File(path) = store.finish().expect("renamed") else {
            panic!("no file");
        };
        assert_eq!(path, folder.path().join("wombat-1/x.bin"));
        assert_eq!(fs::read(&path).expect("there"), b"abcdef");
        assert_eq!(
            fs::read_dir(folder.path().join("wombat-1"))
                .expect("there")
                .count(),
            1,
            "nothing else"
        );
    }

    #[test]
    fn a_record_that_is_damaged_or_of_another_part_is_not_believed() {
        let folder = tempfile::tempdir().expect("a folder");
        let (offer, id) = offer("", b"abcdef");
        let record = folder.path().join(format!("wombat-1/.{id}.record"));
        let part = folder.path().join(format!("wombat-1/.{id}.part"));
        let begun = || {
            let (mut store, _) = Store::in_folder(folder.path(), id, &offer).expect("a store");
            store.write(0, b"abcd").expect("room");
            store.save(&held(0..4)).expect("room");
        };
        let found = || {
            Store::in_folder(folder.path(), id, &offer)
                .expect("a store")
                .1
                .bytes()
        };
        begun();
        assert_eq!(found(), 4);
        fs::write(&record, b"nonsense").expect("written");
        assert_eq!(found(), 0);
        begun();
        fs::write(&record, vec![0; MAX_RECORD_BYTES + 1]).expect("written");
        assert_eq!(found(), 0);
        begun();
        fs::write(&part, b"abc").expect("written");
        assert_eq!(found(), 0, "shorter than the record says");
        begun();
        fs::remove_file(&part).expect("removed");
        assert_eq!(found(), 0);
    }

    #[test]
    fn memory_takes_what_was_said_and_no_more() {
        let mut store = Store::in_memory(6).expect("memory");
        store.write(3, b"def").expect("room");
        store.write(0, b"abc").expect("room");
        assert!(store.write(1 << 40, b"x").is_err());
        assert_eq!(
            store.finish().expect("there"),
            Content::Bytes(Bytes::from_static(b"abcdef"))
        );
        assert!(Store::in_memory(u64::MAX).is_err());
    }

    #[test]
    fn a_disk_that_is_full_is_an_error_with_a_reason() {
        let (offer, _) = offer("x", b"abcdef");
        let Ok(file) = OpenOptions::new().read(true).write(true).open("/dev/full") else {
            return;
        };
        let (part, record, whole) = ("/none/p".into(), "/none/r".into(), "/none/w".into());
        let mut store = Store::File(PartFile {
            file,
            part,
            record,
            whole,
            offer,
        });
        let error = store.write(0, b"abc").expect_err("full").to_string();
        assert!(error.contains("No space left"), "{error}");
        assert!(store.save(&held(0..3)).is_err());
    }

    #[test]
    fn old_parts_go_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let robot = folder.path().join("wombat-1");
        fs::create_dir(&robot).expect("made");
        for name in [".1.part", ".1.record", "x.part", ".keep"] {
            fs::write(robot.join(name), b"x").expect("written");
        }
        Store::clean(folder.path(), SystemTime::now());
        assert_eq!(fs::read_dir(&robot).expect("there").count(), 4);
        Store::clean(folder.path(), SystemTime::now() + KEPT * 2);
        assert_eq!(fs::read_dir(&robot).expect("there").count(), 2);
        Store::clean(Path::new("/none"), SystemTime::now());
    }
}
