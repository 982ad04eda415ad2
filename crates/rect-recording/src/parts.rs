//! Makes files of the folders in which a recorder writes: one at the end, or several if the recording is split.
use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    thread::JoinHandle,
    time::Duration,
};

use crate::{
    file::{About, COMPLETE},
    merge::merge,
    reader::{Extras, ReadError, Reader},
    recorder_error::RecorderError,
    segments::{folder_of, Segments},
};

/// When a recording continues in another file; by default never.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Split {
    /// After this time.
    pub after: Option<Duration>,
    /// When the file has this many bytes.
    pub bytes: Option<u64>,
}

impl Split {
    /// Returns whether a recording is ever split.
    pub fn is_set(&self) -> bool {
        *self != Self::default()
    }

    /// Returns whether a part of that duration and size is complete.
    fn is_due(&self, lasted: Duration, bytes: u64) -> bool {
        self.after.is_some_and(|after| lasted >= after)
            || self.bytes.is_some_and(|limit| bytes >= limit)
    }
}

/// The files of the complete parts, for those who read a recording that runs.
pub(super) type PartPaths = Arc<Mutex<Vec<PathBuf>>>;

/// The parts of a recording. Each one has a folder of its own until it is a file, so that a power cut leaves all of them readable.
pub(super) struct Parts {
    /// The files of the parts that are complete, or will be soon.
    paths: PartPaths,
    path: PathBuf,
    about: About,
    split: Split,
    /// The number of the current part.
    number: u32,
    merging: Vec<JoinHandle<Result<Option<PathBuf>, RecorderError>>>,
}

impl Parts {
    pub(super) fn new(path: PathBuf, about: About, split: Split) -> Self {
        Self {
            paths: PartPaths::default(),
            path,
            about,
            split,
            number: 1,
            merging: Vec::new(),
        }
    }

    /// Returns the list of complete parts.
    pub(super) fn paths(&self) -> PartPaths {
        self.paths.clone()
    }

    /// Begins the next part if the current one is complete. The complete one becomes a file on a thread of its own.
    ///
    /// # Errors
    /// Fails if the disk does. The part continues then.
    pub(super) fn on_time(&mut self, segments: &mut Segments) -> io::Result<()> {
        let is_due = (segments.complete_extent())
            .is_some_and(|(lasted, bytes)| self.split.is_due(lasted, bytes));
        if !is_due {
            return Ok(());
        }
        let path = self.next_path();
        let folder = folder_of(&path);
        segments.continue_elsewhere(&folder)?;
        let mut paths = self.paths.lock().unwrap_or_else(PoisonError::into_inner);
        paths.push(path.clone());
        drop(paths);
        self.number += 1;
        let about = self.about.clone();
        let merging = std::thread::Builder::new().name("recording part".to_owned());
        let merging = merging.spawn(move || file_of(&folder, path, &about))?;
        self.merging.push(merging);
        Ok(())
    }

    /// Makes a file of the last part, and waits for the others. Returns the files.
    ///
    /// # Errors
    /// Fails if the disk does. The folders of the parts that are not files remain, and can be read.
    pub(super) fn finish(self) -> Result<Vec<PathBuf>, RecorderError> {
        let last = match self.split.is_set() {
            true => self.next_path(),
            false => self.path.clone(),
        };
        let last = file_of(&folder_of(&self.path), last, &self.about);
        let mut files = Vec::new();
        for merging in self.merging {
            let lost = || RecorderError::Write {
                path: self.path.clone(),
                source: io::Error::other("the thread that writes a part has panicked"),
            };
            files.extend(merging.join().map_err(|_| lost())??);
        }
        files.extend(last?);
        Ok(files)
    }

    /// Returns the name of the current part. Numbers that other files have are skipped.
    fn next_path(&self) -> PathBuf {
        let paths = (self.number..).map(|number| part(&self.path, number));
        let mut free = paths.filter(|path| !path.exists() && !folder_of(path).exists());
        free.next().unwrap_or_else(|| self.path.clone())
    }
}

/// Returns the name of a part: `match-1.mcap`.
fn part(path: &Path, number: u32) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{number}.{COMPLETE}"))
}

/// Makes a file of a folder, and removes the folder. Returns `None` if nothing was recorded.
fn file_of(folder: &Path, path: PathBuf, about: &About) -> Result<Option<PathBuf>, RecorderError> {
    let file = match Reader::open(folder) {
        Ok(entries) => {
            merge(entries, &path, &Extras::from(about.clone()))?;
            Some(path)
        }
        Err(ReadError::Empty(_)) => None,
        Err(error) => return Err(error.into()),
    };
    let removed = fs::remove_dir_all(folder);
    removed.map_err(|source| RecorderError::Write {
        path: folder.to_owned(),
        source,
    })?;
    Ok(file)
}
