//! Owns `rect completion`.
use std::{io, process::ExitCode};

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
    generate(
        arguments.shell,
        &mut crate::Arguments::command(),
        "rect",
        &mut io::stdout(),
    );
    ExitCode::SUCCESS
}
