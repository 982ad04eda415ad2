//! Finds what a recording contains besides messages, so that a copy keeps it.
use std::{
    fs::File,
    io::{Read, Seek, SeekFrom},
    ops::Range,
    path::{Path, PathBuf},
};

use mcap::{
    records::{AttachmentHeader, Metadata},
    McapError,
};
use rect_core::storage::regular_file;

use super::{files_of, input::Input, layout::Layout, Missing, ReadError};
use crate::file::{About, ABOUT, PROFILE};

/// The largest head of an attachment: its times, its name and its media type.
const MAX_HEAD: u64 = 64 * 1024;
/// The size of the checksum behind an attachment.
const CHECKSUM: u64 = 4;
/// How many bytes of an attachment are read at once.
const READ_BYTES: usize = 64 * 1024;

/// The parts of recordings that are not messages.
#[derive(Clone, Debug, Default)]
pub struct Extras {
    /// The description of the recording, if RECT has recorded it.
    pub about: About,
    /// The profile of the files; empty if they have several.
    pub profile: String,
    /// Further metadata.
    pub metadata: Vec<Metadata>,
    /// The attachments.
    pub attachments: Vec<Attachment>,
}

/// A file within a recording.
#[derive(Clone, Debug)]
pub struct Attachment {
    path: PathBuf,
    /// Where its record is.
    bytes: Range<u64>,
}

impl From<About> for Extras {
    /// Returns those of a recorder.
    fn from(about: About) -> Self {
        Self {
            about,
            profile: PROFILE.to_owned(),
            ..Self::default()
        }
    }
}

impl Extras {
    /// Finds those of several recordings. Damage of the files is reported where the messages are read.
    ///
    /// # Errors
    /// Fails if a file cannot be read.
    pub fn of(recordings: &[PathBuf]) -> Result<Self, ReadError> {
        Self::found(recordings, false)
    }

    /// Finds those of a damaged recording that are whole. Returns the attachments that are not, too.
    ///
    /// # Errors
    /// Fails if a file cannot be read.
    pub fn of_damaged(recording: &Path) -> Result<(Self, Vec<Missing>), ReadError> {
        let mut extras = Self::found(&[recording.to_owned()], true)?;
        let mut missing = Vec::new();
        extras.attachments.retain(|attachment| {
            let Err(error) = attachment.verified() else {
                return true;
            };
            missing.push(Missing {
                path: attachment.path.clone(),
                bytes: attachment.bytes.clone(),
                times: None,
                reason: format!("an attachment: {error}"),
            });
            false
        });
        Ok((extras, missing))
    }

    fn found(recordings: &[PathBuf], is_tolerant: bool) -> Result<Self, ReadError> {
        let mut extras = Self::default();
        let mut profiles = Vec::new();
        for recording in recordings {
            for path in files_of(recording)? {
                let layout = regular_file::open(&path)
                    .and_then(|file| Input::new(Box::new(file)))
                    .and_then(|mut input| Layout::read(&mut input, is_tolerant))
                    .map_err(|error| ReadError::of(&path, 0, error.into()))?;
                extras.add(layout.metadata);
                profiles.push(layout.profile);
                let found = layout.attachments.into_iter().map(|bytes| Attachment {
                    path: path.clone(),
                    bytes,
                });
                extras.attachments.extend(found);
            }
        }
        profiles.dedup();
        if let [profile] = &mut profiles[..] {
            extras.profile = std::mem::take(profile);
        }
        Ok(extras)
    }

    fn add(&mut self, metadata: Vec<Metadata>) {
        for record in metadata {
            if record.name == ABOUT {
                self.about.extend(record.metadata);
            } else if !self.metadata.contains(&record) {
                self.metadata.push(record);
            }
        }
    }
}

impl Attachment {
    /// Verifies the attachment, and opens it. Returns its description, and its content with the number of bytes.
    ///
    /// # Errors
    /// Fails if it is damaged, or the file cannot be read.
    pub fn open(&self) -> Result<(AttachmentHeader, u64, impl Read), ReadError> {
        self.verified()
            .map_err(|error| ReadError::of(&self.path, 0, error))
    }

    fn verified(&self) -> Result<(AttachmentHeader, u64, impl Read), McapError> {
        let mut file = File::open(&self.path)?;
        file.seek(SeekFrom::Start(self.bytes.start))?;
        let all = self.bytes.end - self.bytes.start;
        let mut head = Vec::new();
        file.by_ref()
            .take(all.min(MAX_HEAD))
            .read_to_end(&mut head)?;
        let (header, size, head_bytes) = header(&head).ok_or(McapError::UnexpectedEoc)?;
        let available = all.saturating_sub(head_bytes + CHECKSUM);
        if size != available {
            let header = size;
            return Err(McapError::BadAttachmentLength { header, available });
        }
        file.seek(SeekFrom::Start(self.bytes.start))?;
        let mut checksum = crc32fast::Hasher::new();
        let mut content = file.by_ref().take(all - CHECKSUM);
        let mut buffer = vec![0; READ_BYTES];
        loop {
            match content.read(&mut buffer)? {
                0 => break,
                read => checksum.update(&buffer[..read]),
            }
        }
        let mut saved = [0; CHECKSUM as usize];
        file.read_exact(&mut saved)?;
        let (saved, calculated) = (u32::from_le_bytes(saved), checksum.finalize());
        // A writer that computes none writes 0.
        if saved != 0 && saved != calculated {
            return Err(McapError::BadAttachmentCrc { saved, calculated });
        }
        file.seek(SeekFrom::Start(self.bytes.start + head_bytes))?;
        Ok((header, size, file.take(size)))
    }
}

/// Returns the description of an attachment, the size of its content, and where that begins.
fn header(head: &[u8]) -> Option<(AttachmentHeader, u64, u64)> {
    let (log_time, rest) = head.split_first_chunk()?;
    let (create_time, rest) = rest.split_first_chunk()?;
    let (name, rest) = text(rest)?;
    let (media_type, rest) = text(rest)?;
    let (size, rest) = rest.split_first_chunk()?;
    let header = AttachmentHeader {
        log_time: u64::from_le_bytes(*log_time),
        create_time: u64::from_le_bytes(*create_time),
        name,
        media_type,
    };
    let begin = head.len() - rest.len();
    Some((header, u64::from_le_bytes(*size), begin as u64))
}

fn text(bytes: &[u8]) -> Option<(String, &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    let (text, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    Some((String::from_utf8(text.to_vec()).ok()?, rest))
}
