//! Defines [`RecorderError`].
use std::{
    io,
    path::{Path, PathBuf},
};

use crate::reader::ReadError;

/// Why a recording cannot start, or not become one file.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// There is a file of that name.
    #[error("{} exists already: choose another name", .0.display())]
    Exists(PathBuf),
    /// There is a recording of that name that is not one file.
    #[error(
        "{} exists already: another recorder writes it, or one was interrupted. Choose another name, or make a file of it with \
         `rect recording merge`",
        .0.display()
    )]
    Unfinished(PathBuf),
    /// The folder cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// The parts of the recording cannot be read back.
    #[error("cannot merge the parts of the recording: {0}")]
    Read(#[from] ReadError),
}

impl RecorderError {
    /// Returns the error that a new file cannot be created or written.
    pub fn of_file(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::AlreadyExists => Self::Exists(path),
            _ => Self::Write { path, source },
        }
    }
}
