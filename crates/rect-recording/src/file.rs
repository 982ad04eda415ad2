//! Writes entries to one MCAP file, under a temporary name until it is complete and on the disk.
use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, File},
    io::{self, BufWriter, Read, Seek, Write},
    path::{Path, PathBuf},
    sync::Arc,
};

use mcap::{
    records::{AttachmentHeader, MessageHeader, Metadata},
    write::PrivateRecordOptions,
    McapError, WriteOptions, Writer,
};
use rect_core::{
    name::{key::KeySpace, topic::Pattern},
    storage::regular_file,
};

use crate::{
    channel::{Channel, Form},
    entry::Entry,
    inferred::Inferred,
    log,
    schema::{Foreign, Schema},
    view::{Origin, View},
};

/// The ending of a complete file.
pub const COMPLETE: &str = "mcap";
/// The ending of a file that is being written.
pub const PART: &str = "part";
/// The name of the metadata that describe a recording.
pub const ABOUT: &str = "rect";
/// The compression of chunks: the fastest levels cost little, and text shrinks to a third.
const LEVEL: u32 = 1;
/// MCAP's name for the conventions of this crate.
pub const PROFILE: &str = "rect";
/// The kind of a record that has the payload of the message before it, which is what a viewer shows. Other programs ignore it.
pub const ORIGINAL: u8 = 0x80;
/// How many bytes of an attachment are copied at once.
const COPIED_BYTES: usize = 64 * 1024;
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
    channels: HashMap<Channel, Numbered>,
    /// The channels of other programs, by the address of their descriptions.
    foreign: HashMap<usize, (Arc<Foreign>, u16)>,
    /// The common shape of the objects of each topic.
    inferred: HashMap<String, Inferred>,
    /// How many channels the file has.
    count: usize,
}

/// The number of a channel, and the version of its schema.
#[derive(Clone, Copy)]
struct Numbered {
    id: u16,
    version: u8,
}

impl<W: Write + Seek> Encoder<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Fails if it cannot be written.
    pub fn new(file: W, about: &About) -> io::Result<Self> {
        Self::with_profile(file, PROFILE, about)
    }

    fn with_profile(file: W, profile: &str, about: &About) -> io::Result<Self> {
        let options = WriteOptions::new()
            .profile(profile)
            .library(concat!("rect ", env!("CARGO_PKG_VERSION")))
            .compression_level(LEVEL)
            .compression_threads(0);
        let writer = options.create(file).map_err(into_io)?;
        let mut encoder = Self {
            writer,
            channels: HashMap::new(),
            foreign: HashMap::new(),
            inferred: HashMap::new(),
            count: 0,
        };
        if !about.is_empty() {
            encoder.add_metadata(&Metadata {
                name: ABOUT.to_owned(),
                metadata: about.clone(),
            })?;
        }
        Ok(encoder)
    }

    fn add_metadata(&mut self, metadata: &Metadata) -> io::Result<()> {
        self.writer.write_metadata(metadata).map_err(into_io)
    }

    /// Adds an entry.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn add(&mut self, entry: &Entry) -> io::Result<()> {
        self.try_add(entry).map_err(into_io)
    }

    fn try_add(&mut self, entry: &Entry) -> Result<(), McapError> {
        let payload = &entry.payload.bytes;
        if let Some(foreign) = &entry.foreign {
            let id = self.foreign_channel(&entry.topic, foreign)?;
            return self.write(id, entry, payload);
        }
        let view = View::of(entry);
        let (form, message) = match &view {
            View::Picture(kind, message) => (Form::Picture(*kind), message),
            View::Object(Origin::Payload, text) => (Form::Object, text),
            View::Object(Origin::Value, text) => (Form::View, text),
            // Other programs may know the encoding.
            View::Object(Origin::Description, _) => (Form::Payload, payload),
        };
        let version = match form {
            Form::Picture(_) | Form::Payload => 0,
            _ if log::is_log(&entry.topic) => 0,
            Form::Object | Form::View => match self.inferred.get_mut(&entry.topic) {
                Some(inferred) => inferred.add(message),
                None => {
                    let topic = entry.topic.clone();
                    self.inferred.entry(topic).or_default().add(message)
                }
            },
        };
        let channel = Channel::of(entry, form);
        let id = match self.channels.get(&channel) {
            Some(known) if known.version == version => known.id,
            _ => self.add_channel(channel, version)?,
        };
        self.write(id, entry, message)?;
        if form == Form::View {
            // In the same chunk.
            let options = PrivateRecordOptions::IncludeInChunks;
            self.writer
                .write_private_record(ORIGINAL, payload, options.into())?;
        }
        Ok(())
    }

    fn write(&mut self, channel_id: u16, entry: &Entry, message: &[u8]) -> Result<(), McapError> {
        let header = MessageHeader {
            channel_id,
            sequence: entry.sequence,
            log_time: nanoseconds(entry.logged),
            publish_time: nanoseconds(entry.sent),
        };
        self.writer.write_to_known_channel(&header, message)
    }

    fn add_channel(&mut self, channel: Channel, version: u8) -> Result<u16, McapError> {
        let schema = match channel.form {
            Form::Payload => None,
            Form::Picture(kind) => Some(kind.schema()),
            _ if log::is_log(&channel.topic) => Some(log::schema()),
            Form::Object | Form::View => {
                let inferred = self.inferred.get(&channel.topic);
                inferred.map(|inferred| inferred.schema(&channel.topic))
            }
        };
        let (encoding, metadata) = (channel.message_encoding(), channel.metadata());
        let id = self.new_channel(&channel.topic, encoding, schema.as_ref(), &metadata)?;
        self.channels.insert(channel, Numbered { id, version });
        Ok(id)
    }

    fn foreign_channel(&mut self, topic: &str, foreign: &Arc<Foreign>) -> Result<u16, McapError> {
        // It remains that of this description, because the map holds it.
        let address = Arc::as_ptr(foreign) as usize;
        if let Some((_, id)) = self.foreign.get(&address) {
            return Ok(*id);
        }
        let Foreign {
            message_encoding,
            schema,
            metadata,
        } = &**foreign;
        let id = self.new_channel(topic, message_encoding, schema.as_deref(), metadata)?;
        self.foreign.insert(address, (foreign.clone(), id));
        Ok(id)
    }

    fn new_channel(
        &mut self,
        topic: &str,
        encoding: &str,
        schema: Option<&Schema>,
        metadata: &BTreeMap<String, String>,
    ) -> Result<u16, McapError> {
        if self.count >= MAX_CHANNELS {
            let many = format!("the messages have more than {MAX_CHANNELS} topics and publishers");
            return Err(io::Error::other(many).into());
        }
        self.count += 1;
        let schema_id = match schema {
            Some(Schema {
                name,
                encoding,
                text,
            }) => self.writer.add_schema(name, encoding, text)?,
            None => 0,
        };
        self.writer
            .add_channel(schema_id, topic, encoding, metadata)
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
        Self::with_profile(path, PROFILE, about)
    }

    /// Creates a file of another profile.
    ///
    /// # Errors
    /// Fails like [`create`](Self::create).
    pub fn with_profile(path: PathBuf, profile: &str, about: &About) -> io::Result<Self> {
        if path.exists() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        let part = part_of(&path);
        let file = regular_file::create_new(&part)?;
        match Encoder::with_profile(BufWriter::new(file), profile, about) {
            Ok(encoder) => Ok(Self { path, encoder }),
            Err(error) => {
                // Otherwise it would exist at the next attempt.
                let _ = fs::remove_file(part);
                Err(error)
            }
        }
    }

    /// Adds metadata.
    ///
    /// # Errors
    /// Fails if the disk does.
    pub fn add_metadata(&mut self, metadata: &Metadata) -> io::Result<()> {
        self.encoder.add_metadata(metadata)
    }

    /// Adds an attachment of `size` bytes.
    ///
    /// # Errors
    /// Fails if the disk does, or there are fewer bytes.
    pub fn attach(
        &mut self,
        header: AttachmentHeader,
        size: u64,
        content: &mut impl Read,
    ) -> io::Result<()> {
        let writer = &mut self.encoder.writer;
        writer.start_attachment(size, header).map_err(into_io)?;
        let mut buffer = vec![0; COPIED_BYTES];
        loop {
            let read = content.read(&mut buffer)?;
            if read == 0 {
                return writer.finish_attachment().map_err(into_io);
            }
            let put = writer.put_attachment_bytes(&buffer[..read]);
            put.map_err(into_io)?;
        }
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
        self.encoder.count
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
        let renamed = self.encoder.finish().and_then(|mut buffer| {
            buffer.flush()?;
            buffer.get_ref().sync_all()?;
            fs::rename(&part, &self.path)
        });
        let finished = match renamed {
            // Otherwise its entries would be in it and in the next one.
            Ok(()) => sync_folder_of(&self.path).inspect_err(|_| {
                let _ = fs::remove_file(&self.path);
            }),
            Err(error) => {
                // If that fails as well, the next attempt has another name, and the file can be removed by hand.
                let _ = fs::remove_file(part);
                Err(error)
            }
        };
        finished.map(|()| self.path)
    }

    /// Removes the unfinished file.
    pub fn abandon(self) {
        // Without the destructors, which would write once more.
        drop(self.encoder.writer.into_inner().into_parts());
        let _ = fs::remove_file(part_of(&self.path));
    }
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
