//! Implements `rect-router man` and `rect-router completion`: writes manual pages and scripts for shell completion.
use std::{fs, io, path::Path};

use clap::CommandFactory;
use clap_mangen::Man;

use super::{program, Failure};
use crate::args::{Args, CompletionArgs, ManArgs};

/// Prints the completion script of a shell.
pub fn complete(args: &CompletionArgs) {
    let mut command = Args::command();
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "rect-router", &mut script);
    rect_terminal::outln!("{}", String::from_utf8_lossy(&script).trim_end());
}

/// The commands of `rect` whose arguments are only known here.
const COMMANDS_OF_RECT: [&str; 4] = ["init", "check", "sim", "wifi"];

/// Writes the manual pages to a folder, which is created if it does not exist. If `rect` executes this program, only those of its
/// commands that this program implements.
///
/// # Errors
/// Fails if a page cannot be written.
pub fn write(args: &ManArgs) -> Result<(), Failure> {
    let folder = &args.folder;
    let write = || match program() {
        "rect" => write_commands_of_rect(folder),
        _ => clap_mangen::generate_to(Args::command(), folder),
    };
    fs::create_dir_all(folder)
        .and_then(|()| write())
        .map_err(|error| format!("{}: {error}", folder.display()))?;
    Ok(())
}

fn write_commands_of_rect(folder: &Path) -> io::Result<()> {
    let mut rect = Args::command().name("rect").bin_name("rect");
    rect.build();
    for name in COMMANDS_OF_RECT {
        let Some(command) = rect.find_subcommand(name) else {
            continue;
        };
        let command = command.clone().display_name(format!("rect-{name}"));
        Man::new(command).generate_to(folder)?;
    }
    Ok(())
}
