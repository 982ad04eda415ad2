//! Owns `rect man`.
use std::{path::PathBuf, process::ExitCode};

use clap::{Args, CommandFactory};

use crate::Done;

/// Write the manual's pages, one for each command, such as: rect man /usr/local/share/man/man1
#[derive(Args)]
pub struct ManArguments {
    /// A folder that is there
    folder: PathBuf,
}

/// `rect man`.
pub fn run(arguments: &ManArguments) -> Done {
    clap_mangen::generate_to(crate::Arguments::command(), &arguments.folder)
        .map_err(|error| format!("{}: {error}", arguments.folder.display()))?;
    Ok(ExitCode::SUCCESS)
}
