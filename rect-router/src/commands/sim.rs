//! Owns `rect sim`: named robots to play with, each with a router of its own, linked over the simulated air. Everything
//! ends with this command.
mod air;
mod program;
mod robot;

use std::{
    process::ExitCode,
    sync::mpsc::{self, Receiver, RecvTimeoutError},
    thread,
    time::{Duration, Instant},
};

use rect::terminal::Table;
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    iterator::Signals,
};
use tempfile::TempDir;

use self::{air::Air, program::Program, robot::Robot};
use super::{Failure, SimArgs};

/// How often to look whether the routers still run.
const LOOK: Duration = Duration::from_millis(200);
/// How long the routers have to start, and then to link with each other.
const START_TIMEOUT: Duration = Duration::from_secs(30);

/// Longer commands are not aligned with the others.
const COMMAND_WIDTH: usize = 30;

/// The reason why the start was interrupted.
enum Interrupted {
    /// Ctrl-C, SIGTERM, or the terminal was closed.
    BySignal,
    /// Something did not work.
    By(Failure),
}

pub fn run(args: &SimArgs) -> Result<ExitCode, Failure> {
    // Before anything is started, so that no signal can leave it behind.
    let signals = signals()?;
    let folder = TempDir::with_prefix("rect-sim-")?;
    let air = Air::start(args.condition, folder.path())?;
    let mut robots = Vec::new();
    for number in 1..=args.robots {
        robots.push(Robot::start(number, args, &air, folder.path())?);
    }
    let ended = match start(args, &signals, &mut robots) {
        Ok(programs) => {
            show(args, &air, &robots);
            let ended = wait(&signals, &mut robots);
            drop(programs);
            ended
        }
        Err(Interrupted::BySignal) => Ok(()),
        Err(Interrupted::By(failure)) => Err(failure),
    };
    robot::stop(robots);
    ended.map(|()| ExitCode::SUCCESS)
}

/// A message for each signal that asks for the end.
fn signals() -> Result<Receiver<()>, Failure> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    let (sender, receiver) = mpsc::channel();
    let forward = move || {
        for _ in signals.forever() {
            if sender.send(()).is_err() {
                return;
            }
        }
    };
    thread::Builder::new()
        .name("signals".to_owned())
        .spawn(forward)?;
    Ok(receiver)
}

/// Waits until the routers answer and are linked; returns the robots' programs.
fn start(
    args: &SimArgs,
    signals: &Receiver<()>,
    robots: &mut [Robot],
) -> Result<Vec<Program>, Interrupted> {
    rect::errln!("rect: starting {} robots ...", robots.len());
    let deadline = Instant::now() + START_TIMEOUT;
    let mut programs = Vec::new();
    for n in 0..robots.len() {
        let session = loop {
            pause(signals, robots)?;
            match robots[n].session() {
                Ok(session) => break session,
                Err(error) if Instant::now() > deadline => {
                    let log = robots[n].log_tail();
                    let what = format!(
                        "the router of {} does not answer: {error}\n{log}",
                        robots[n].name
                    );
                    return Err(Interrupted::By(what.into()));
                }
                Err(_) => {}
            }
        };
        let program = Program::start(session, &args.fleet, &robots[n].name, !args.quiet);
        programs.push(program.map_err(|error| Interrupted::By(error.to_string().into()))?);
    }
    let deadline = Instant::now() + START_TIMEOUT;
    while !programs[0].has_peers(robots.len() - 1) {
        if Instant::now() > deadline {
            rect::errln!("rect: not all robots are linked yet; they go on trying");
            break;
        }
        pause(signals, robots)?;
    }
    Ok(programs)
}

/// Waits for a moment.
fn pause(signals: &Receiver<()>, robots: &mut [Robot]) -> Result<(), Interrupted> {
    match signals.recv_timeout(LOOK) {
        Err(RecvTimeoutError::Timeout) => robot::all_run(robots).map_err(Interrupted::By),
        Ok(()) | Err(RecvTimeoutError::Disconnected) => Err(Interrupted::BySignal),
    }
}

/// Waits for a signal, or for a router that ends by itself.
fn wait(signals: &Receiver<()>, robots: &mut [Robot]) -> Result<(), Failure> {
    loop {
        match pause(signals, robots) {
            Ok(()) => {}
            Err(Interrupted::BySignal) => return Ok(()),
            Err(Interrupted::By(failure)) => return Err(failure),
        }
    }
}

/// Prints which robots there are, and what to try.
fn show(args: &SimArgs, air: &Air, robots: &[Robot]) {
    let mut table = Table::new(&["ROBOT", "ROUTER"]);
    for robot in robots {
        table.row(vec![
            robot.name.as_str().into(),
            robot.endpoint.as_str().into(),
        ]);
    }
    table.print();
    let (first, second) = (&robots[0], &robots[1]);
    let condition = args.condition;
    rect::outln!(
        "\nlinked by Bluetooth LE over the simulated air ({condition}). In another terminal:\n"
    );
    if !first.has_default_endpoint() {
        rect::outln!("  export RECT_ENDPOINT={}", first.endpoint);
    }
    if let Some(socket) = air.other_socket() {
        rect::outln!("  export RECT_AIR={}", socket.display());
    }
    let fleet = match args.fleet.as_str() {
        "rect" => String::new(),
        fleet => format!(" --fleet {fleet}"),
    };
    let (one, two) = (&first.name, &second.name);
    let mut tries = vec![
        (format!("rect peers{fleet}"), "which robots are there"),
        (
            format!("rect connections{fleet}"),
            "and how they are linked",
        ),
    ];
    if !args.quiet {
        tries.extend([
            (
                format!("rect sub '*/**'{fleet}"),
                "everything that they publish",
            ),
            (format!("rect topic list{fleet}"), "which topics there are"),
            (
                format!("rect request {two} battery{fleet}"),
                "ask a service",
            ),
        ]);
    }
    tries.extend([
        (
            format!("rect pub greeting hello{fleet}"),
            "publish as that robot",
        ),
        (
            format!("rect sub '{one}/**'{fleet} --router {}", second.endpoint),
            "at the other",
        ),
        (
            "rect air cut".to_owned(),
            "out of range, and back: rect air restore",
        ),
    ]);
    let width = tries
        .iter()
        .map(|(command, _)| command.len())
        .max()
        .unwrap_or(0)
        .min(COMMAND_WIDTH);
    for (command, what) in tries {
        rect::outln!("  {command:width$}  # {what}");
    }
    rect::outln!("\nCtrl-C ends everything.");
}
