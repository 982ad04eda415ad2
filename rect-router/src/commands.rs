//! Runs the commands of `rect-router`: they write a robot's configuration, show the status of running routers, and
//! diagnose problems. Their arguments are in `args::command`.
mod check;
mod client;
mod cloud;
mod connections;
mod doctor;
mod init;
mod manual;
mod scan;
mod service;
mod sim;
mod status;
mod wifi;

use std::{env, process::ExitCode};

use rect_core::text::{display, humanize};
use rect_terminal::{paint_err, Style};

use crate::args::Command;

/// The reason why a command failed.
type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Runs a command and reports its error, if any, on stderr.
pub fn run(command: &Command) -> ExitCode {
    let done = match command {
        Command::Init(args) => init::run(args).map(|()| ExitCode::SUCCESS),
        Command::Check(args) => check::run(args).map(|()| ExitCode::SUCCESS),
        Command::Status(args) => status::run(args).map(|()| ExitCode::SUCCESS),
        Command::Connections(args) => connections::run(args).map(|()| ExitCode::SUCCESS),
        Command::Scan(args) => scan::run(args).map(|()| ExitCode::SUCCESS),
        Command::Doctor(args) => doctor::run(args),
        Command::Sim(args) => sim::run(args),
        Command::Wifi(args) => wifi::run(args).map(|()| ExitCode::SUCCESS),
        Command::Completion(args) => {
            manual::complete(args);
            Ok(ExitCode::SUCCESS)
        }
        Command::Man(args) => manual::write(args).map(|()| ExitCode::SUCCESS),
    };
    done.unwrap_or_else(|error| {
        // Another robot may have sent a part of the message, so control characters are removed.
        let text = display::line(&humanize::with_causes(error.as_ref())).into_owned();
        let program = format!("{}:", program());
        rect_terminal::errln!("{} {text}", paint_err(Style::Wrong, &program));
        ExitCode::FAILURE
    })
}

/// Returns the name under which the user started this program: the command `rect` executes it for some of its commands.
fn program() -> &'static str {
    let name = env::args_os().next();
    if name.is_some_and(|name| name == "rect") {
        "rect"
    } else {
        "rect-router"
    }
}
