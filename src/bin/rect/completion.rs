//! Owns `rect completion`.
use std::process::ExitCode;

use clap::{Args, CommandFactory};
use clap_complete::{generate, Shell};

/// Print what makes a shell complete these commands, such as: rect completion bash > /etc/bash_completion.d/rect
#[derive(Args)]
pub struct CompletionArguments {
    /// Which shell
    shell: Shell,
}

/// `rect completion`.
pub fn run(arguments: &CompletionArguments) -> ExitCode {
    let mut script = Vec::new();
    let mut command = crate::Arguments::command();
    generate(arguments.shell, &mut command, "rect", &mut script);
    rect::outln!("{}", String::from_utf8_lossy(&script).trim_end());
    ExitCode::SUCCESS
}
