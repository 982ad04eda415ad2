//! Writes entries of other recordings to one file.
use std::path::Path;

use crate::{
    entry::Entry,
    file::OpenFile,
    reader::{Extras, ReadError},
    recorder_error::RecorderError,
};

/// Writes entries to a file, and what else the recordings contain. The file is complete and on the disk when this returns. Returns how
/// many messages there are.
///
/// # Errors
/// Fails if the recording cannot be read, or the file exists or cannot be written. No unfinished file remains.
pub fn merge(
    entries: impl Iterator<Item = Result<Entry, ReadError>>,
    path: &Path,
    extras: &Extras,
) -> Result<u64, RecorderError> {
    let failed = |source| RecorderError::of_file(path, source);
    let file = OpenFile::with_profile(path.to_owned(), &extras.profile, &extras.about);
    let mut file = file.map_err(failed)?;
    let mut count = 0;
    let add = || -> Result<(), RecorderError> {
        for record in &extras.metadata {
            file.add_metadata(record).map_err(failed)?;
        }
        for attachment in &extras.attachments {
            let (header, size, mut content) = attachment.open()?;
            file.attach(header, size, &mut content).map_err(failed)?;
        }
        for entry in entries {
            let entry = entry?;
            count += u64::from(!entry.is_report());
            file.add(&entry).map_err(failed)?;
        }
        Ok(())
    };
    let added = add();
    if let Err(error) = added {
        file.abandon();
        return Err(error);
    }
    file.finish().map_err(failed)?;
    Ok(count)
}
