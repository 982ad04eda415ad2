//! Reads recordings: a file, also of another program, or the folder of a recording that runs or was interrupted.
mod by_time;
mod contents;
mod extras;
mod input;
mod layout;

use std::{
    collections::VecDeque,
    fs,
    io::{self, Read, Seek},
    path::{Path, PathBuf},
    time::Duration,
};

use mcap::{
    sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions},
    McapError,
};
use rect_core::storage::regular_file;

use self::{by_time::ByTime, input::Input, layout::MAX_RECORD};
use crate::{
    entry::Entry,
    file::{About, ABOUT, COMPLETE, PART},
    retained::Repeats,
};

pub use self::{by_time::Missing, extras::Extras, input::Source};

/// A recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file or folder cannot be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// The folder contains no recording.
    #[error("the folder {} contains no recording (no file *.{COMPLETE})", .0.display())]
    Empty(PathBuf),
    /// The file is damaged, or is no MCAP file.
    #[error(
        "{} is damaged after {entries} messages: {source}. `rect recording recover` writes what is whole to another file",
        path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// How many messages were read before.
        entries: u64,
        /// The cause.
        source: McapError,
    },
}

impl ReadError {
    fn of(path: &Path, entries: u64, source: McapError) -> Self {
        let path = path.to_owned();
        match source {
            McapError::Io(source) => Self::Io { path, source },
            source => Self::Damaged {
                path,
                entries,
                source,
            },
        }
    }
}

/// Reads the messages of a recording in the order in which they were recorded: that of their times, also if a file has another one.
/// The files of a folder follow each other. A retained value that a file repeats from a file before it is read once.
pub struct Reader {
    /// The files that are still to be read.
    files: VecDeque<PathBuf>,
    open: Option<OpenFile>,
    about: About,
    is_complete: bool,
    /// Whether damaged parts are skipped.
    is_tolerant: bool,
    missing: Vec<Missing>,
    repeats: Repeats,
}

struct OpenFile {
    path: PathBuf,
    messages: ByTime,
    entries: u64,
}

impl Reader {
    /// Opens a file, or a folder of segments.
    ///
    /// # Errors
    /// Fails if there is nothing to read.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        Ok(Self::of_files(files_of(path)?))
    }

    /// Opens a recording that may be damaged, to read everything that is whole.
    ///
    /// # Errors
    /// Fails if there is nothing to read.
    pub fn open_damaged(path: &Path) -> Result<Self, ReadError> {
        Ok(Self {
            is_tolerant: true,
            ..Self::open(path)?
        })
    }

    /// Reads files one after the other.
    pub fn of_files(files: Vec<PathBuf>) -> Self {
        Self {
            files: files.into(),
            open: None,
            about: About::new(),
            is_complete: true,
            is_tolerant: false,
            missing: Vec::new(),
            repeats: Repeats::default(),
        }
    }

    /// Reads a complete file from anywhere. Errors call it `path`.
    ///
    /// # Errors
    /// Fails if it cannot be read.
    pub fn of(path: PathBuf, file: impl Source + 'static) -> Result<Self, ReadError> {
        let mut reader = Self::of_files(Vec::new());
        reader.begin(path, Box::new(file))?;
        Ok(reader)
    }

    /// Returns the description of the recording, if it has been read already.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// Returns whether all files that have been read so far were complete.
    pub fn is_complete(&self) -> bool {
        self.is_complete
    }

    /// Returns what could not be read of the files that have been read so far.
    pub fn missing(&self) -> &[Missing] {
        &self.missing
    }

    fn begin(&mut self, path: PathBuf, file: Box<dyn Source>) -> Result<(), ReadError> {
        let messages = Input::new(file)
            .map_err(McapError::Io)
            .and_then(|input| ByTime::new(path.clone(), input, self.is_tolerant));
        let (messages, metadata) = messages.map_err(|error| ReadError::of(&path, 0, error))?;
        let about = metadata.into_iter().find(|record| record.name == ABOUT);
        if let Some(about) = about.filter(|_| self.about.is_empty()) {
            self.about = about.metadata;
        }
        self.open = Some(OpenFile {
            path,
            messages,
            entries: 0,
        });
        Ok(())
    }

    fn read(&mut self) -> Result<Option<Entry>, ReadError> {
        loop {
            let Some(open) = &mut self.open else {
                let Some(path) = self.files.pop_front() else {
                    return Ok(None);
                };
                let file = regular_file::open(&path).map_err(|source| ReadError::Io {
                    path: path.clone(),
                    source,
                })?;
                self.begin(path, Box::new(file))?;
                continue;
            };
            match open.messages.next() {
                Ok(Some(entry)) => {
                    open.entries += 1;
                    if self.repeats.is_known(&entry) {
                        continue;
                    }
                    return Ok(Some(entry));
                }
                Ok(None) => self.end(),
                Err(error) => {
                    let error = ReadError::of(&open.path, open.entries, error);
                    let is_part = open.path.extension().is_some_and(|ending| ending == PART);
                    self.is_complete = false;
                    self.end();
                    // A file that was not completed is whole up to here.
                    if !is_part || !matches!(error, ReadError::Damaged { .. }) {
                        return Err(error);
                    }
                }
            }
        }
    }

    fn end(&mut self) {
        if let Some(open) = self.open.take() {
            let missing = open.messages.into_missing();
            self.is_complete &= missing.is_empty();
            self.missing.extend(missing);
        }
    }
}

/// Returns the files of a recording in their order: the file itself, or those in a folder.
///
/// # Errors
/// Fails if there is nothing to read.
pub fn files_of(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let failed = |source| ReadError::Io {
        path: path.to_owned(),
        source,
    };
    if !fs::metadata(path).map_err(failed)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut found = Vec::new();
    for entry in fs::read_dir(path).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        let ending = file.extension().unwrap_or_default();
        if ending == COMPLETE || ending == PART {
            found.push(file);
        }
    }
    if found.is_empty() {
        return Err(ReadError::Empty(path.to_owned()));
    }
    // The names are numbers of the same length.
    found.sort();
    Ok(found)
}

/// Returns when the last message of a complete file was recorded, without reading the messages; `None` if the file is not
/// complete.
pub fn end_of(path: &Path) -> Option<Duration> {
    let mut file = regular_file::open(path).ok()?;
    let options = SummaryReaderOptions::default().with_record_length_limit(MAX_RECORD);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event.ok()? {
            SummaryReadEvent::ReadRequest(bytes) => {
                let read = file.read(reader.insert(bytes)).ok()?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to).ok()?),
        }
    }
    let statistics = reader.finish()?.stats?;
    Some(Duration::from_nanos(statistics.message_end_time))
}

impl Iterator for Reader {
    type Item = Result<Entry, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read().transpose()
    }
}
