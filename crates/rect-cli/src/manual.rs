//! Implements `rect man`.
use std::{fs, path::PathBuf};

use clap::{Args, CommandFactory};

use crate::{router, Done};

/// Write a manual page for each command to a folder, as in: rect man /usr/local/share/man/man1
#[derive(Args)]
pub struct ManArguments {
    /// The folder, which is created if it does not exist
    folder: PathBuf,
}

/// Runs `rect man`.
pub fn run(arguments: &ManArguments) -> Done {
    let folder = &arguments.folder;
    fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(crate::Arguments::command(), folder))
        .map_err(|error| format!("{}: {error}", folder.display()))?;
    // It replaces the pages of the commands whose arguments only it knows.
    router::manual(folder)
}
