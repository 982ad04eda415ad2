//! Implements `rect man`.
use std::{path::PathBuf, process::ExitCode};

use clap::{Args, CommandFactory};

use crate::Done;

/// Write a manual page for each command to a folder, as in: rect man /usr/local/share/man/man1
#[derive(Args)]
pub struct ManArguments {
    /// An existing folder
    folder: PathBuf,
}

/// Runs `rect man`.
pub fn run(arguments: &ManArguments) -> Done {
    clap_mangen::generate_to(crate::Arguments::command(), &arguments.folder)
        .map_err(|error| format!("{}: {error}", arguments.folder.display()))?;
    Ok(ExitCode::SUCCESS)
}
