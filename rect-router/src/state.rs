//! Keeps the values that the programs of the robot retain, and their file.
use std::{
    io,
    path::{Path, PathBuf},
};

use rect::{KeptState, Save};
use rect_core::{
    name::key::KeySpace,
    state::keeper::{Disk, IsServed},
    storage::{regular_file, ReplacedFile},
};
use zenoh::Session;

use crate::config::Settings;

/// The name of the file, in the folder of the connections file, unless the settings name another one.
const FILE: &str = "retained.cbor";
/// The maximum size of the file; a larger one is not read.
const MAX_BYTES: u64 = 4 << 20;

/// Begins to keep the state of the robot of `place`. `is_served`: whether a program serves a topic.
///
/// # Errors
/// Fails if a queryable or subscriber cannot be declared, or if the thread cannot be started.
pub fn serve(
    session: &Session,
    place: KeySpace,
    settings: &Settings,
    is_served: IsServed,
) -> zenoh::Result<KeptState> {
    let (disk, save): (_, Save) = match path(settings) {
        None => {
            let reason = "this router has no file for retained values, which are lost when it ends: set plugins/rect/retained in its configuration";
            (Disk::None(reason.to_owned()), Box::new(|_| Ok(())))
        }
        Some(path) => {
            let saved = read(&path);
            if let Err(error) = &saved {
                tracing::warn!(
                    "{}: cannot read the retained values, which are lost: {error}",
                    path.display()
                );
            }
            let file = ReplacedFile::new(&path);
            let save = move |bytes: &[u8]| {
                let replaced = file.replace(bytes);
                replaced.map_err(|error| format!("{}: {error}", path.display()))
            };
            (Disk::Saved(saved.unwrap_or_default()), Box::new(save))
        }
    };
    Ok(KeptState::start(session, place, disk, save, is_served)?)
}

fn path(settings: &Settings) -> Option<PathBuf> {
    let beside = settings.connections.as_ref().and_then(|path| path.parent());
    let beside = beside.map(|folder| folder.join(FILE));
    settings.retained.clone().or(beside)
}

/// Returns the bytes of the file; `None` if there is none.
fn read(path: &Path) -> io::Result<Option<Vec<u8>>> {
    match regular_file::read(path, MAX_BYTES) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        read => read.map(Some),
    }
}
