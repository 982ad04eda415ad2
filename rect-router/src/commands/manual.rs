//! Owns what is told of the commands beside `--help`: manual pages, and what makes a shell complete them.
use clap::CommandFactory;

use super::{CompletionArgs, Failure, ManArgs};
use crate::args::Args;

pub fn complete(args: &CompletionArgs) {
    let mut command = Args::command();
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "rect-router", &mut script);
    rect::outln!("{}", String::from_utf8_lossy(&script).trim_end());
}

pub fn write(args: &ManArgs) -> Result<(), Failure> {
    clap_mangen::generate_to(Args::command(), &args.folder)
        .map_err(|error| format!("{}: {error}", args.folder.display()))?;
    Ok(())
}
