//! Implements `rect completion`.
use std::process::ExitCode;

use clap::{Args, CommandFactory};
use clap_complete::{generate, Shell};

/// Print a completion script for a shell, as in: rect completion bash > /etc/bash_completion.d/rect
#[derive(Args)]
pub struct CompletionArguments {
    /// The shell
    shell: Shell,
}

/// Runs `rect completion`.
pub fn run(arguments: &CompletionArguments) -> ExitCode {
    let mut script = Vec::new();
    let mut command = crate::Arguments::command();
    generate(arguments.shell, &mut command, "rect", &mut script);
    rect_terminal::outln!("{}", String::from_utf8_lossy(&script).trim_end());
    ExitCode::SUCCESS
}
