//! Implements `rect-router man` and `rect-router completion`: writes manual pages and scripts for shell completion.
use clap::CommandFactory;

use super::Failure;
use crate::args::{Args, CompletionArgs, ManArgs};

/// Prints the completion script of a shell.
pub fn complete(args: &CompletionArgs) {
    let mut command = Args::command();
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "rect-router", &mut script);
    rect_terminal::outln!("{}", String::from_utf8_lossy(&script).trim_end());
}

/// Writes the manual pages to a folder.
///
/// # Errors
/// Fails if a page cannot be written.
pub fn write(args: &ManArgs) -> Result<(), Failure> {
    clap_mangen::generate_to(Args::command(), &args.folder)
        .map_err(|error| format!("{}: {error}", args.folder.display()))?;
    Ok(())
}
