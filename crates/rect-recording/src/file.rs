//! Writes entries to one MCAP file, under a temporary name until it is complete and on the disk.
use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, File},
    io::{self, BufWriter, Seek, Write},
    path::{Path, PathBuf},
};

use mcap::{records::MessageHeader, records::Metadata, McapError, WriteOptions, Writer};
use rect_core::name::{key::KeySpace, topic::Pattern};
use serde_json::Value;

use crate::{
    channel::Channel,
    entry::Entry,
    picture::{self, Kind},
    schema::Schema,
};

/// The ending of a complete file.
pub const COMPLETE: &str = "mcap";
/// The ending of a file that is being written.
pub const PART: &str = "part";
/// The name of the metadata that describe a recording.
pub const ABOUT: &str = "rect";
/// The compression of chunks: the fastest levels cost little, and text shrinks to a third.
const LEVEL: u32 = 1;
const PROFILE: &str = "rect";
/// How many channels a file may have. Their ids have 16 bits.
const MAX_CHANNELS: usize = 60_000;

/// The description of a recording: names and values.
pub type About = BTreeMap<String, String>;

/// The entry of [`About`] that says what was recorded.
const PATTERNS: &str = "patterns";

/// Returns the description of a recording by a program of the robot of `place`.
pub fn about(place: &KeySpace, patterns: &[Pattern]) -> About {
    let robot = &place.robot;
    let patterns = match patterns {
        [] => format!("{robot}/** and messages to {robot}"),
        some => Vec::from_iter(some.iter().map(ToString::to_string)).join(", "),
    };
    [
        ("robot", robot.to_string()),
        ("fleet", place.fleet.to_string()),
        (PATTERNS, patterns),
        ("rect", env!("CARGO_PKG_VERSION").to_owned()),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

/// Returns what is recorded, according to the description of the recording.
pub fn patterns(about: &About) -> &str {
    about.get(PATTERNS).map_or("", String::as_str)
}

/// An MCAP file that is being written.
pub struct OpenFile {
    /// The name that it gets when it is complete.
    path: PathBuf,
    encoder: Encoder<BufWriter<File>>,
}

/// Writes entries in the form of MCAP.
pub struct Encoder<W: Write + Seek> {
    writer: Writer<W>,
    channels: HashMap<Channel, u16>,
}

impl<W: Write + Seek> Encoder<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Fails if it cannot be written.
    pub fn new(file: W, about: &About) -> io::Result<Self> {
        let options = WriteOptions::new()
            .profile(PROFILE)
            .library(concat!("rect ", env!("CARGO_PKG_VERSION")))
            .compression_level(LEVEL)
            .compression_threads(0);
        let writer = options.create(file).map_err(into_io)?;
        let mut encoder = Self {
            writer,
            channels: HashMap::new(),
        };
        let about = Metadata {
            name: ABOUT.to_owned(),
            metadata: about.clone(),
        };
        encoder.writer.write_metadata(&about).map_err(into_io)?;
        Ok(encoder)
    }

    /// Adds an entry.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn add(&mut self, entry: &Entry) -> io::Result<()> {
        let channel = Channel::of(entry);
        let channel_id = match self.channels.get(&channel) {
            Some(id) => *id,
            None => self.add_channel(channel, entry).map_err(into_io)?,
        };
        let header = MessageHeader {
            channel_id,
            sequence: entry.sequence,
            log_time: nanoseconds(entry.logged),
            publish_time: nanoseconds(entry.sent),
        };
        let written = match picture::wrap(entry) {
            Some(message) => (self.writer).write_to_known_channel(&header, &message),
            None => (self.writer).write_to_known_channel(&header, &entry.payload.bytes),
        };
        written.map_err(into_io)
    }

    fn add_channel(&mut self, channel: Channel, first: &Entry) -> Result<u16, McapError> {
        if self.channels.len() >= MAX_CHANNELS {
            let many = format!("the messages have more than {MAX_CHANNELS} topics and publishers");
            return Err(io::Error::other(many).into());
        }
        let schema = match Kind::of(&channel.encoding) {
            Some(kind) => Some(Schema::of_picture(kind)),
            None => entry_schema(first),
        };
        let schema_id = match schema {
            Some(schema) => {
                (self.writer).add_schema(&schema.name, schema.encoding, &schema.text)?
            }
            None => 0,
        };
        let (encoding, metadata) = (channel.message_encoding(), channel.metadata());
        let id = (self.writer).add_channel(schema_id, &channel.topic, encoding, &metadata)?;
        self.channels.insert(channel, id);
        Ok(id)
    }

    /// Completes the file, and returns what it was written to.
    ///
    /// # Errors
    /// Fails if it cannot be written.
    pub fn finish(mut self) -> io::Result<W> {
        self.writer.finish().map_err(into_io)?;
        Ok(self.writer.into_inner())
    }
}

impl OpenFile {
    /// Creates the file.
    ///
    /// # Errors
    /// Fails if the file or its unfinished form exists, or cannot be written.
    pub fn create(path: PathBuf, about: &About) -> io::Result<Self> {
        if path.exists() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        let file = File::create_new(part_of(&path))?;
        Ok(Self {
            path,
            encoder: Encoder::new(BufWriter::new(file), about)?,
        })
    }

    /// Adds an entry.
    ///
    /// # Errors
    /// Fails if the disk does.
    pub fn add(&mut self, entry: &Entry) -> io::Result<()> {
        self.encoder.add(entry)
    }

    /// Returns the number of channels.
    pub fn channels(&self) -> usize {
        self.encoder.channels.len()
    }

    /// Ends the chunk, so that a reader finds everything up to here if the file is never completed.
    ///
    /// # Errors
    /// Fails if the disk does.
    pub fn flush(&mut self) -> io::Result<()> {
        self.encoder.writer.flush().map_err(into_io)
    }

    /// Completes the file, waits until it is on the disk, and gives it its name.
    ///
    /// # Errors
    /// Fails if the disk does. The unfinished file is removed then.
    pub fn finish(self) -> io::Result<PathBuf> {
        let part = part_of(&self.path);
        let finished = self.encoder.finish().and_then(|mut buffer| {
            buffer.flush()?;
            buffer.get_ref().sync_all()?;
            fs::rename(&part, &self.path)?;
            sync_folder_of(&self.path)
        });
        if finished.is_err() {
            // If that fails as well, the next attempt has another name, and the file can be removed by hand.
            let _ = fs::remove_file(part);
        }
        finished.map(|()| self.path)
    }

    /// Removes the unfinished file.
    pub fn abandon(self) {
        // Without the destructors, which would write once more.
        drop(self.encoder.writer.into_inner().into_parts());
        let _ = fs::remove_file(part_of(&self.path));
    }
}

fn entry_schema(entry: &Entry) -> Option<Schema> {
    let is_json = entry.is_json();
    let value = is_json.then(|| serde_json::from_slice(&entry.payload.bytes));
    let value: Value = value?.ok()?;
    Some(Schema::of_value(&entry.topic, &value))
}

/// Returns the name of the unfinished form of a file.
pub fn part_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(PART);
    name.into()
}

/// Makes new names in the folder of a file survive a power cut.
fn sync_folder_of(path: &Path) -> io::Result<()> {
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

fn nanoseconds(time: std::time::Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

fn into_io(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        error => io::Error::other(error),
    }
}
