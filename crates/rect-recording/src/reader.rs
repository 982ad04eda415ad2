//! Reads recordings: a file, also of another program, or the folder of a recording that runs or was interrupted.
use std::{
    collections::{HashMap, VecDeque},
    fs::{self, File},
    io::{self, Read, Seek},
    path::{Path, PathBuf},
    time::Duration,
};

use bytes::Bytes;
use mcap::{
    records::{op, Record},
    sans_io::{
        linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
        summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions},
    },
    McapError,
};
use rect_core::message::payload::Payload;

use crate::{
    channel::Channel,
    chunk::Chunk,
    entry::Entry,
    file::{About, ABOUT, COMPLETE, PART},
    picture::{self, Kind},
};

/// The largest record that is read, in bytes. Recordings of RECT have chunks of about 1 MB.
const MAX_RECORD: usize = 64 * 1024 * 1024;

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
    #[error("{} is damaged after {entries} messages: {source}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// How many messages were read before.
        entries: u64,
        /// The cause.
        source: McapError,
    },
}

/// Reads the messages of a recording in the order in which they were recorded.
pub struct Reader {
    /// The files that are still to be read.
    files: VecDeque<PathBuf>,
    open: Option<OpenFile>,
    about: About,
    is_complete: bool,
}

struct OpenFile {
    path: PathBuf,
    file: Box<dyn Read + Send>,
    reader: LinearReader,
    /// The chunk whose records are being read.
    chunk: Chunk,
    contents: Contents,
}

/// The part of a file that has been read.
#[derive(Default)]
struct Contents {
    channels: HashMap<u16, Channel>,
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

    /// Reads files one after the other.
    pub fn of_files(files: Vec<PathBuf>) -> Self {
        Self {
            files: files.into(),
            open: None,
            about: About::new(),
            is_complete: true,
        }
    }

    /// Reads a complete file from anywhere. Errors call it `path`.
    pub fn of(path: PathBuf, file: impl Read + Send + 'static) -> Self {
        Self {
            files: VecDeque::new(),
            open: Some(OpenFile::new(path, Box::new(file))),
            about: About::new(),
            is_complete: true,
        }
    }

    /// Returns the description of the recording, if it has been read already.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// Returns whether all files that have been read so far were complete.
    pub fn is_complete(&self) -> bool {
        self.is_complete
    }

    fn read(&mut self) -> Result<Option<Entry>, ReadError> {
        loop {
            let open = match &mut self.open {
                Some(open) => open,
                None => match self.files.pop_front() {
                    Some(path) => self.open.insert(OpenFile::open(path)?),
                    None => return Ok(None),
                },
            };
            match open.read(&mut self.about) {
                Ok(Some(entry)) => return Ok(Some(entry)),
                Ok(None) => self.open = None,
                // It was not completed, and everything up to here is whole.
                Err(ReadError::Damaged { .. }) if open.is_part() => {
                    self.is_complete = false;
                    self.open = None;
                }
                Err(error) => {
                    self.is_complete = false;
                    self.open = None;
                    return Err(error);
                }
            }
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
    let mut file = File::open(path).ok()?;
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

impl OpenFile {
    fn open(path: PathBuf) -> Result<Self, ReadError> {
        let file = File::open(&path).map_err(|source| ReadError::Io {
            path: path.clone(),
            source,
        })?;
        Ok(Self::new(path, Box::new(file)))
    }

    fn new(path: PathBuf, file: Box<dyn Read + Send>) -> Self {
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            .with_record_length_limit(MAX_RECORD);
        Self {
            path,
            file,
            reader: LinearReader::new_with_options(options),
            chunk: Chunk::default(),
            contents: Contents::default(),
        }
    }

    fn is_part(&self) -> bool {
        self.path.extension().is_some_and(|ending| ending == PART)
    }

    /// Returns the next message; `None` at the end of the file.
    fn read(&mut self, about: &mut About) -> Result<Option<Entry>, ReadError> {
        loop {
            match self.step(about) {
                Ok(Step::Entry(entry)) => return Ok(Some(entry)),
                Ok(Step::End) => return Ok(None),
                Ok(Step::Continue) => {}
                Err(McapError::Io(source)) => {
                    let path = self.path.clone();
                    return Err(ReadError::Io { path, source });
                }
                Err(source) => {
                    return Err(ReadError::Damaged {
                        path: self.path.clone(),
                        entries: self.contents.entries,
                        source,
                    })
                }
            }
        }
    }

    fn step(&mut self, about: &mut About) -> Result<Step, McapError> {
        if let Some((kind, data)) = self.chunk.next()? {
            return self.contents.on_record(kind, data, about);
        }
        match self.reader.next_event().transpose()? {
            None => Ok(Step::End),
            Some(LinearReadEvent::ReadRequest(bytes)) => {
                let read = self.file.read(self.reader.insert(bytes))?;
                self.reader.notify_read(read);
                Ok(Step::Continue)
            }
            Some(LinearReadEvent::Record { opcode, data }) if opcode == op::CHUNK => {
                if let Record::Chunk { header, data } = parsed(opcode, data)? {
                    self.chunk = Chunk::read(&header, &data, MAX_RECORD)?;
                }
                Ok(Step::Continue)
            }
            Some(LinearReadEvent::Record { opcode, data }) => {
                self.contents.on_record(opcode, data, about)
            }
        }
    }
}

/// The result of reading a little.
enum Step {
    Entry(Entry),
    Continue,
    End,
}

impl Contents {
    fn on_record(&mut self, kind: u8, data: &[u8], about: &mut About) -> Result<Step, McapError> {
        if !matches!(kind, op::CHANNEL | op::METADATA | op::MESSAGE) {
            return Ok(Step::Continue);
        }
        match parsed(kind, data)? {
            Record::Channel(channel) => {
                self.channels.insert(channel.id, Channel::read(channel));
            }
            Record::Metadata(metadata) if metadata.name == ABOUT && about.is_empty() => {
                *about = metadata.metadata;
            }
            Record::Message { header, data } => {
                let channel = self.channels.get(&header.channel_id);
                let unknown = || McapError::UnknownChannel(header.sequence, header.channel_id);
                let channel = channel.ok_or_else(unknown)?;
                self.entries += 1;
                let wrapped = Kind::of(&channel.encoding);
                let picture = wrapped.and_then(|kind| picture::unwrap(kind, &data));
                let bytes = picture.unwrap_or_else(|| Bytes::copy_from_slice(&data));
                return Ok(Step::Entry(Entry {
                    topic: channel.topic.clone(),
                    recipient: channel.recipient.clone(),
                    payload: Payload::new(bytes, channel.encoding.clone()),
                    urgency: channel.urgency,
                    sequence: header.sequence,
                    publisher: channel.publisher,
                    logged: Duration::from_nanos(header.log_time),
                    sent: Duration::from_nanos(header.publish_time),
                }));
            }
            _ => {}
        }
        Ok(Step::Continue)
    }
}

/// Parses a record. The library's parser believes the lengths of strings, and reserves memory for them.
fn parsed(kind: u8, data: &[u8]) -> Result<Record<'_>, McapError> {
    if !strings_fit(kind, data) {
        return Err(McapError::UnexpectedEoc);
    }
    mcap::parse_record(kind, data)
}

/// Returns whether the strings of a record are no longer than the record, since a parser would reserve memory for them.
fn strings_fit(opcode: u8, data: &[u8]) -> bool {
    let rest = match opcode {
        // The numbers of the channel and its schema, the topic, and the encoding.
        op::CHANNEL => data
            .get(4..)
            .and_then(without_string)
            .and_then(without_string),
        op::METADATA => without_string(data),
        // The times, the size and the checksum, and the compression; then the records.
        op::CHUNK => return data.get(28..).and_then(without_string).is_some(),
        _ => return true,
    };
    // Pairs of a name and a value, after their length in bytes. The parser looks for a missing value behind them.
    let rest = rest.and_then(|rest| rest.split_first_chunk());
    let map = rest.and_then(|(length, rest)| rest.get(..u32::from_le_bytes(*length) as usize));
    let Some(mut rest) = map else { return false };
    while !rest.is_empty() {
        match without_string(rest).and_then(without_string) {
            Some(after) => rest = after,
            None => return false,
        }
    }
    true
}

/// Returns the bytes after a string and its length.
fn without_string(bytes: &[u8]) -> Option<&[u8]> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.get(u32::from_le_bytes(*length) as usize..)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a metadata record without a name, whose map has that length, followed by these bytes.
    fn metadata(length: u32, rest: &[u8]) -> Vec<u8> {
        [[0; 4].as_slice(), &length.to_le_bytes(), rest].concat()
    }

    #[test]
    fn a_name_without_a_value_is_refused() {
        // Behind the map is what the parser would take for the length of a string.
        let record = metadata(4, &[[0; 4], [0xaa; 4]].concat());
        assert!(matches!(
            parsed(op::METADATA, &record),
            Err(McapError::UnexpectedEoc)
        ));
        let pair = metadata(8, &[0; 8]);
        assert!(matches!(
            parsed(op::METADATA, &pair),
            Ok(Record::Metadata(_))
        ));
    }
}
