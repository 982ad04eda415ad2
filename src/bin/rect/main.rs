//! The `rect` command. Owns its arguments and its exit status; what each command does is in a module of its own.
mod air;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The Robot Extensible Communication Toolkit: robots that talk over Bluetooth LE.
#[derive(Parser)]
#[command(name = "rect", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Air(air::AirArguments),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_env("RUST_LOG")
                .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn")),
        )
        .with_writer(std::io::stderr)
        .init();
    let done = match arguments.command {
        Command::Air(arguments) => air::run(arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("rect: {error}");
            ExitCode::FAILURE
        }
    }
}
