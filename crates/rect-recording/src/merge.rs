//! Writes entries of other recordings to one file.
use std::path::Path;

use crate::{
    entry::Entry,
    file::{About, OpenFile},
    reader::ReadError,
    recorder_error::RecorderError,
};

/// Writes entries to a file, which is complete and on the disk when this returns. Returns how many messages there are.
///
/// # Errors
/// Fails if the recording cannot be read, or the file exists or cannot be written. No unfinished file remains.
pub fn merge(
    entries: impl Iterator<Item = Result<Entry, ReadError>>,
    path: &Path,
    about: &About,
) -> Result<u64, RecorderError> {
    let failed = |source| RecorderError::of_file(path, source);
    let mut file = OpenFile::create(path.to_owned(), about).map_err(failed)?;
    let mut count = 0;
    for entry in entries {
        let added = entry.map_err(RecorderError::from).and_then(|entry| {
            count += u64::from(!entry.is_report());
            file.add(&entry).map_err(failed)
        });
        if let Err(error) = added {
            file.abandon();
            return Err(error);
        }
    }
    file.finish().map_err(failed)?;
    Ok(count)
}
