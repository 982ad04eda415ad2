//! Writes a recording as a folder of short files, so that a power cut costs at most the one that is being written. Each file begins with
//! the values that were retained before it.
use std::{
    collections::VecDeque,
    fs, io,
    path::{Path, PathBuf},
    time::Duration,
};

use rect_core::storage::regular_file;

use crate::{
    entry::Entry,
    file::{About, OpenFile, COMPLETE},
    retained::LastValues,
};

/// The time after which a file is completed and the next one begins.
pub const SEGMENT: Duration = Duration::from_secs(5);
/// The number of bytes after which that happens earlier: they are kept in memory until then, in case the disk is full.
pub const SEGMENT_BYTES: usize = 8 * 1024 * 1024;
/// The number of bytes after which a file is completed on a disk that is nearly full: whole files use the room that is left.
const LEAST_SEGMENT_BYTES: usize = 64 * 1024;
/// The number of channels after which that happens, so that a flood of topics does not exhaust the ids of a file.
const SEGMENT_CHANNELS: usize = 10_000;
/// The interval at which a chunk is ended. An unfinished file can be read up to its last chunk.
const CHUNK: Duration = Duration::from_secs(1);
/// The ending of the folder.
pub const FOLDER: &str = "segments";
/// The ending of the folder that becomes the next one.
const NEXT: &str = "next";

/// A recording that is being written.
pub struct Segments {
    folder: PathBuf,
    about: About,
    /// The number of the next file.
    next: u32,
    open: Option<Open>,
    complete: VecDeque<Complete>,
    /// The number of bytes after which a file is completed: half as many after each failure, and twice as many after each
    /// success.
    segment_bytes: usize,
    /// The entries of a file that could not be completed.
    returned: Vec<Entry>,
    /// How much of the past to keep. `None`: everything.
    keep: Option<Duration>,
    /// The retained values at the end of the last complete file.
    retained: LastValues,
}

/// The file that is being written.
struct Open {
    file: OpenFile,
    /// Its entries, which are written again if the disk turns out to be full.
    entries: Vec<Entry>,
    bytes: usize,
    started: Duration,
    chunk_started: Duration,
}

struct Complete {
    path: PathBuf,
    started: Duration,
    ended: Duration,
    bytes: u64,
}

impl Segments {
    /// Creates the folder of a recording.
    ///
    /// # Errors
    /// Fails with [`io::ErrorKind::AlreadyExists`] if another recorder writes there, or a recording was interrupted.
    pub fn create(folder: PathBuf, about: About, keep: Option<Duration>) -> io::Result<Self> {
        regular_file::create_folder(&folder)?;
        Ok(Self {
            folder,
            about,
            next: 1,
            open: None,
            complete: VecDeque::new(),
            segment_bytes: SEGMENT_BYTES,
            returned: Vec::new(),
            keep,
            retained: LastValues::default(),
        })
    }

    /// Writes an entry.
    ///
    /// # Errors
    /// Fails if the disk does. The entry is returned by [`abandon`](Self::abandon) with the others of its file.
    pub fn write(&mut self, entry: Entry) -> io::Result<()> {
        let now = entry.logged;
        let is_first = self.open.is_none();
        let open = match &mut self.open {
            Some(open) => open,
            None => {
                let name = format!("{:06}.{COMPLETE}", self.next);
                let file = match OpenFile::create(self.folder.join(name), &self.about) {
                    Ok(file) => file,
                    Err(error) => {
                        // A file that an earlier failure has left remains, and does not end the recording.
                        self.next += u32::from(error.kind() == io::ErrorKind::AlreadyExists);
                        self.returned.push(entry);
                        return Err(error);
                    }
                };
                self.next += 1;
                self.open.insert(Open {
                    file,
                    entries: Vec::new(),
                    bytes: 0,
                    started: now,
                    chunk_started: now,
                })
            }
        };
        open.bytes += entry.bytes();
        open.entries.push(entry);
        // On a disk that is nearly full, they would take the room of the messages.
        if is_first && self.retained.bytes() <= self.segment_bytes {
            for repeated in self.retained.repeated(now) {
                open.file.add(&repeated)?;
            }
        }
        let Some(entry) = open.entries.last() else {
            return Ok(());
        };
        open.file.add(entry)
    }

    /// Ends the chunk or the file if that is due.
    ///
    /// # Errors
    /// Fails if the disk does.
    pub fn on_time(&mut self, now: Duration) -> io::Result<()> {
        let Some(open) = &mut self.open else {
            return Ok(());
        };
        if now.saturating_sub(open.started) >= SEGMENT
            || open.bytes >= self.segment_bytes
            || open.file.channels() >= SEGMENT_CHANNELS
        {
            return self.finish(now);
        }
        if now.saturating_sub(open.chunk_started) >= CHUNK {
            open.chunk_started = now;
            open.file.flush()?;
        }
        Ok(())
    }

    /// Ends the chunk, so that everything can be read.
    ///
    /// # Errors
    /// Fails if the disk does.
    pub fn flush(&mut self) -> io::Result<()> {
        match &mut self.open {
            Some(open) => open.file.flush(),
            None => Ok(()),
        }
    }

    /// Completes the file that is being written, and removes those that are older than what is kept.
    ///
    /// # Errors
    /// Fails if the disk does. [`abandon`](Self::abandon) returns the entries of the file then.
    pub fn finish(&mut self, now: Duration) -> io::Result<()> {
        if let Some(Open {
            file,
            entries,
            started,
            ..
        }) = self.open.take()
        {
            match file.finish() {
                Ok(path) => {
                    self.segment_bytes = (self.segment_bytes * 2).min(SEGMENT_BYTES);
                    for entry in entries {
                        self.retained.on_entry(entry);
                    }
                    self.complete.push_back(Complete {
                        bytes: fs::metadata(&path)?.len(),
                        path,
                        started,
                        ended: now,
                    });
                }
                Err(error) => {
                    self.returned = entries;
                    return Err(error);
                }
            }
        }
        let Some(keep) = self.keep else { return Ok(()) };
        while let Some(oldest) = self.complete.front() {
            if now.saturating_sub(oldest.ended) <= keep {
                break;
            }
            fs::remove_file(&oldest.path)?;
            self.complete.pop_front();
        }
        Ok(())
    }

    /// Returns how long the complete files last and how many bytes they have; `None` while a file is being written.
    pub fn complete_extent(&self) -> Option<(Duration, u64)> {
        if self.open.is_some() {
            return None;
        }
        let (first, last) = (self.complete.front()?, self.complete.back()?);
        let bytes = self.complete.iter().map(|complete| complete.bytes).sum();
        Some((last.ended.saturating_sub(first.started), bytes))
    }

    /// Gives the folder, in which no file is being written, another name, and continues in a new one.
    ///
    /// # Errors
    /// Fails if the disk does.
    pub fn continue_elsewhere(&mut self, renamed: &Path) -> io::Result<()> {
        // Made first: if the disk has no room for it, the recording continues in its folder.
        let next = self.folder.with_extension(NEXT);
        match regular_file::create_folder(&next) {
            Err(error) if !next.is_dir() => return Err(error),
            _ => {}
        }
        let moved = fs::rename(&self.folder, renamed).and_then(|()| {
            fs::rename(&next, &self.folder).inspect_err(|_| {
                let _ = fs::rename(renamed, &self.folder);
            })
        });
        if let Err(error) = moved {
            let _ = fs::remove_dir(next);
            return Err(error);
        }
        self.complete.clear();
        Ok(())
    }

    /// Removes the unfinished file, which the disk did not take, and returns its entries.
    pub fn abandon(&mut self) -> Vec<Entry> {
        self.segment_bytes = (self.segment_bytes / 2).max(LEAST_SEGMENT_BYTES);
        match self.open.take() {
            Some(open) => {
                open.file.abandon();
                open.entries
            }
            None => std::mem::take(&mut self.returned),
        }
    }
}

/// Returns the folder in which a recording is written until it becomes the file `path`.
pub fn folder_of(path: &Path) -> PathBuf {
    path.with_extension(FOLDER)
}
