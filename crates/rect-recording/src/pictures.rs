//! Writes the pictures and videos of a recording to files.
use std::{
    collections::{btree_map, BTreeMap},
    fs,
    io::{self, Write},
    path::PathBuf,
};

use rect_core::{storage::regular_file, video::bitstream};

use crate::{entry::Entry, picture, video_file::VideoFile};

/// The maximum length of the name of a folder, in bytes.
const MAX_NAME: usize = 100;

/// Writes pictures to a folder, in which each topic has one: `wombat-1-camera/000012.jpeg`, and videos to Matroska files:
/// `wombat-1-camera.mkv`.
pub struct Pictures {
    folder: PathBuf,
    /// The number of the last picture of each topic.
    last: BTreeMap<String, u32>,
    videos: BTreeMap<String, VideoFile>,
    written: u64,
}

impl Pictures {
    /// Creates the folder.
    ///
    /// # Errors
    /// Fails if there is one of that name, or it cannot be created.
    pub fn create(folder: PathBuf) -> io::Result<Self> {
        regular_file::create_folder(&folder)?;
        Ok(Self {
            folder,
            last: BTreeMap::new(),
            videos: BTreeMap::new(),
            written: 0,
        })
    }

    /// Writes a picture or a frame of a video, as it was sent. Other messages are skipped.
    ///
    /// # Errors
    /// Fails if the disk does.
    pub fn add(&mut self, entry: &Entry) -> io::Result<()> {
        if bitstream::is_video(&entry.payload) {
            return self.add_frame(entry);
        }
        let Some(format) = picture::format(&entry.payload.encoding) else {
            return Ok(());
        };
        let topic = self.folder.join(folder_name(&entry.topic));
        let number = self.last.entry(entry.topic.clone()).or_default();
        if *number == 0 {
            // Two topics may have the same name here.
            fs::create_dir_all(&topic)?;
        }
        *number += 1;
        let mut file = loop {
            match regular_file::create_new(&topic.join(format!("{number:06}.{format}"))) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => *number += 1,
                created => break created?,
            }
        };
        self.written += 1;
        file.write_all(&entry.payload.bytes)
    }

    fn add_frame(&mut self, entry: &Entry) -> io::Result<()> {
        let video = match self.videos.entry(entry.topic.clone()) {
            btree_map::Entry::Occupied(known) => known.into_mut(),
            btree_map::Entry::Vacant(vacant) => {
                let mut name = folder_name(&entry.topic);
                // Two topics may have the same name here.
                while self.folder.join(format!("{name}.mkv")).exists() {
                    name.push('_');
                }
                let path = self.folder.join(format!("{name}.mkv"));
                vacant.insert(VideoFile::new(path).map_err(io::Error::other)?)
            }
        };
        let added = video.add(&entry.payload.bytes, entry.sent);
        added.map_err(io::Error::other)
    }

    /// Returns how many pictures, and frames of videos, were written.
    pub fn written(&self) -> u64 {
        let frames: u64 = self.videos.values().map(|video| video.written().0).sum();
        self.written + frames
    }
}

/// Returns the name of a topic's folder, in which only letters, digits, `-` and `_` of it remain: a recording may be hostile.
fn folder_name(topic: &str) -> String {
    let topic = topic.trim_matches('/').chars().take(MAX_NAME);
    let kept = topic.map(|c| match c {
        '/' => '-',
        c if c.is_ascii_alphanumeric() || "-_".contains(c) => c,
        _ => '_',
    });
    kept.collect()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use rect_core::message::{encoding::Encoding, payload::Payload, urgency::Urgency};

    #[test]
    fn pictures_are_written_below_the_folder_only() {
        let outside = tempfile::tempdir().expect("a folder");
        let folder = outside.path().join("pictures");
        let mut pictures = Pictures::create(folder.clone()).expect("created");
        for (topic, encoding) in [
            ("a/camera", Encoding::JPEG),
            ("a/camera", Encoding::JPEG),
            ("a/camera", Encoding::JSON),
            ("../../evil\u{1b}", Encoding::PNG),
            ("a/came.ra", Encoding::WEBP),
            ("a/came_ra", Encoding::WEBP),
        ] {
            let entry = Entry {
                topic: topic.to_owned(),
                recipient: None,
                payload: Payload::new("picture", encoding),
                urgency: Urgency::Bulk,
                sequence: 0,
                publisher: None,
                logged: Duration::ZERO,
                sent: Duration::ZERO,
                retained: None,
                foreign: None,
            };
            pictures.add(&entry).expect("written");
        }
        let mut found = Vec::new();
        for topic in fs::read_dir(&folder).expect("a folder") {
            for file in fs::read_dir(topic.expect("a topic").path()).expect("a folder") {
                let path = file.expect("a file").path();
                let name = path.strip_prefix(&folder).expect("below");
                found.push(name.to_string_lossy().into_owned());
            }
        }
        found.sort();
        let expected = [
            "__-__-evil_/000001.png",
            "a-came_ra/000001.webp",
            "a-came_ra/000002.webp",
            "a-camera/000001.jpeg",
            "a-camera/000002.jpeg",
        ];
        assert_eq!(found, expected);
        assert_eq!(pictures.written(), 5);
        assert_eq!(fs::read_dir(outside.path()).expect("a folder").count(), 1);
    }
}
