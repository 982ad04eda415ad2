//! Reads the data that a transfer sends: bytes in memory, or a file that must not change until the
//! transfer has ended.
use std::{
    fs::{File, Metadata},
    io::{self, Read, Seek, SeekFrom},
    ops::Range,
    path::{Path, PathBuf},
    time::SystemTime,
};

use bytes::Bytes;

use super::checksum;
use crate::transfer::{Checksum, Fault};

/// The source of a transfer: bytes in memory, or a file.
#[derive(Debug)]
pub struct Source {
    kind: Kind,
    size_bytes: u64,
    checksum: Checksum,
}

#[derive(Debug)]
enum Kind {
    Bytes(Bytes),
    File {
        file: File,
        path: PathBuf,
        /// The time of the last modification, if the file system provides it.
        written: Option<SystemTime>,
    },
}

impl Source {
    /// Creates a source from bytes in memory. Computing the checksum takes about one second per gigabyte.
    pub fn of_bytes(bytes: Bytes) -> Self {
        let (size_bytes, checksum) = (bytes.len() as u64, Checksum::of(&bytes));
        let kind = Kind::Bytes(bytes);
        Self {
            kind,
            size_bytes,
            checksum,
        }
    }

    /// Creates a source from a file. The file is read once for its checksum, and then in pieces when they are
    /// requested.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, or if it is not a regular file.
    pub fn of_file(path: &Path) -> io::Result<Self> {
        let mut file = File::open(path)?;
        let before = file.metadata()?;
        if !before.is_file() {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                "it is not a file",
            ));
        }
        let (checksum, size_bytes) = checksum(&mut file)?;
        let kind = Kind::File {
            file,
            path: path.to_owned(),
            written: before.modified().ok(),
        };
        Ok(Self {
            kind,
            size_bytes,
            checksum,
        })
    }

    /// Returns the size in bytes.
    pub fn size_bytes(&self) -> u64 {
        self.size_bytes
    }

    /// Returns the checksum.
    pub fn checksum(&self) -> Checksum {
        self.checksum
    }

    /// Reads a range of bytes, whose start must not exceed its end.
    ///
    /// # Errors
    /// Returns [`Fault::Changed`] if the file has changed since the source was created or is shorter than the range,
    /// [`Fault::Unreadable`] if it cannot be read, and [`Fault::Protocol`] if the range exceeds the bytes in memory.
    pub fn read(&self, range: Range<u64>) -> Result<Bytes, Fault> {
        match &self.kind {
            Kind::Bytes(bytes) => {
                let end = usize::try_from(range.end)
                    .ok()
                    .filter(|&end| end <= bytes.len());
                let start = usize::try_from(range.start).ok();
                let both = start.zip(end).filter(|(start, end)| start <= end);
                let (start, end) = both.ok_or_else(|| Fault::Protocol("no such bytes".into()))?;
                Ok(bytes.slice(start..end))
            }
            Kind::File {
                file,
                path,
                written,
            } => {
                let unreadable = |error: io::Error| match error.kind() {
                    io::ErrorKind::UnexpectedEof => {
                        Fault::Changed(format!("{} has become shorter", path.display()))
                    }
                    _ => Fault::Unreadable(format!("{}: {error}", path.display())),
                };
                let mut bytes = vec![0; (range.end - range.start) as usize];
                let mut file: &File = file;
                file.seek(SeekFrom::Start(range.start))
                    .map_err(unreadable)?;
                file.read_exact(&mut bytes).map_err(unreadable)?;
                self.check_unchanged(&file.metadata().map_err(unreadable)?, path, *written)?;
                Ok(bytes.into())
            }
        }
    }

    fn check_unchanged(
        &self,
        now: &Metadata,
        path: &Path,
        written: Option<SystemTime>,
    ) -> Result<(), Fault> {
        if now.len() == self.size_bytes && now.modified().ok() == written {
            return Ok(());
        }
        Err(Fault::Changed(format!("{} was modified", path.display())))
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, time::Duration};

    use super::*;

    #[test]
    fn bytes_and_files_behave_alike() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("x");
        fs::write(&path, b"abcdef").expect("written");
        let sources = [
            Source::of_bytes(Bytes::from_static(b"abcdef")),
            Source::of_file(&path).expect("a file"),
        ];
        for source in sources {
            assert_eq!(
                (source.size_bytes(), source.checksum()),
                (6, Checksum::of(b"abcdef"))
            );
            assert_eq!(source.read(2..5).expect("in range"), &b"cde"[..]);
            assert_eq!(source.read(6..6).expect("in range"), &b""[..]);
            assert!(source.read(5..7).is_err());
        }
    }

    #[test]
    fn detects_a_file_that_changed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("x");
        fs::write(&path, b"abcdef").expect("written");
        let source = Source::of_file(&path).expect("a file");
        fs::write(&path, b"abc").expect("written");
        assert!(
            matches!(source.read(0..6), Err(Fault::Changed(_))),
            "shorter"
        );
        fs::write(&path, b"ABCDEF").expect("written");
        let later = SystemTime::now() + Duration::from_secs(5);
        File::options()
            .write(true)
            .open(&path)
            .and_then(|file| file.set_modified(later))
            .expect("set");
        assert!(
            matches!(source.read(0..6), Err(Fault::Changed(_))),
            "other bytes"
        );
        assert!(Source::of_file(folder.path()).is_err(), "a folder");
        assert!(Source::of_file(&folder.path().join("none")).is_err());
    }
}
