//! Implements `rect sim`: runs simulated robots, each with its own router, linked over the simulated air. They end with this
//! command.
mod air;
mod program;
mod robot;

use std::{
    process::ExitCode,
    sync::mpsc::{self, Receiver, RecvTimeoutError},
    thread,
    time::{Duration, Instant},
};

use rect_terminal::Table;
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    iterator::Signals,
};
use tempfile::TempDir;

use self::{
    air::Air,
    program::Program,
    robot::{SharedFiles, SimulatedRobot},
};
use super::{wifi::Serving, Failure};
use crate::args::SimArgs;

/// Interval at which the routers are checked.
const POLL_INTERVAL: Duration = Duration::from_millis(200);
/// Timeout for the start of the routers, and then for the links between them.
const START_TIMEOUT: Duration = Duration::from_secs(30);

/// Maximum width of the column of commands; comments after longer commands are not aligned.
const COMMAND_WIDTH: usize = 30;

/// The reason why the simulation was interrupted.
enum Interrupted {
    /// A signal arrived: Ctrl-C, SIGTERM, or the terminal was closed.
    BySignal,
    /// An error occurred.
    ByFailure(Failure),
}

/// Starts the robots, shows what to try, and waits for a signal.
///
/// # Errors
/// Fails if the air or a router cannot be started, or if a router ends by itself.
pub fn run(args: &SimArgs) -> Result<ExitCode, Failure> {
    // Handle signals before starting any process, so that a signal cannot leave one behind.
    let signals = signals()?;
    let folder = TempDir::with_prefix("rect-sim-")?;
    let air = Air::start(args.condition, folder.path())?;
    let wifi = args.wifi.then(|| Serving::start(air.socket()));
    let _wifi = wifi.transpose()?;
    let files = SharedFiles::write(folder.path())?;
    let mut robots = Vec::new();
    for number in 1..=args.robots {
        robots.push(SimulatedRobot::start(number, args, &air, &files)?);
    }
    let ended = match start(args, &signals, &mut robots) {
        Ok(programs) => {
            show(args, &air, &robots);
            let ended = wait(&signals, &mut robots);
            drop(programs);
            ended
        }
        Err(Interrupted::BySignal) => Ok(()),
        Err(Interrupted::ByFailure(failure)) => Err(failure),
    };
    robot::stop(robots);
    ended.map(|()| ExitCode::SUCCESS)
}

/// Returns a channel that receives an item for each signal that requests the end.
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

/// Waits until the routers answer and are linked, and returns the robots' programs.
fn start(
    args: &SimArgs,
    signals: &Receiver<()>,
    robots: &mut [SimulatedRobot],
) -> Result<Vec<Program>, Interrupted> {
    rect_terminal::errln!("rect: starting {} robots ...", robots.len());
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
                    return Err(Interrupted::ByFailure(what.into()));
                }
                Err(_) => {}
            }
        };
        let program = Program::start(session, &args.fleet, &robots[n].name, !args.quiet);
        programs.push(program.map_err(|error| Interrupted::ByFailure(error.to_string().into()))?);
    }
    let deadline = Instant::now() + START_TIMEOUT;
    while !programs[0].has_peers(robots.len() - 1) {
        if Instant::now() > deadline {
            rect_terminal::errln!("rect: not all robots are linked yet; they keep trying");
            break;
        }
        pause(signals, robots)?;
    }
    Ok(programs)
}

/// Waits for one polling interval.
///
/// # Errors
/// Fails if a signal arrives or a router ends by itself.
fn pause(signals: &Receiver<()>, robots: &mut [SimulatedRobot]) -> Result<(), Interrupted> {
    match signals.recv_timeout(POLL_INTERVAL) {
        Err(RecvTimeoutError::Timeout) => {
            robot::check_running(robots).map_err(Interrupted::ByFailure)
        }
        Ok(()) | Err(RecvTimeoutError::Disconnected) => Err(Interrupted::BySignal),
    }
}

/// Waits for a signal.
///
/// # Errors
/// Fails if a router ends by itself.
fn wait(signals: &Receiver<()>, robots: &mut [SimulatedRobot]) -> Result<(), Failure> {
    loop {
        match pause(signals, robots) {
            Ok(()) => {}
            Err(Interrupted::BySignal) => return Ok(()),
            Err(Interrupted::ByFailure(failure)) => return Err(failure),
        }
    }
}

/// Prints the robots and some commands to try.
fn show(args: &SimArgs, air: &Air, robots: &[SimulatedRobot]) {
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
    let wifi = if args.wifi {
        " and a simulated Wi-Fi"
    } else {
        ""
    };
    rect_terminal::outln!(
        "\nlinked by Bluetooth LE over the simulated air ({condition}){wifi}. In another terminal:\n"
    );
    if !first.has_default_endpoint() {
        rect_terminal::outln!("  export RECT_ENDPOINT={}", first.endpoint);
    }
    if let Some(socket) = air.non_default_socket() {
        rect_terminal::outln!("  export RECT_AIR={}", socket.display());
    }
    let fleet = match args.fleet.as_str() {
        "rect" => String::new(),
        fleet => format!(" --fleet {fleet}"),
    };
    let (one, two) = (&first.name, &second.name);
    let mut tries = vec![
        (format!("rect peers{fleet}"), "show the other robots"),
        (
            format!("rect connections{fleet}"),
            "show how they are linked",
        ),
    ];
    if !args.quiet {
        tries.extend([
            (
                format!("rect sub '*/**'{fleet}"),
                "receive everything that they publish",
            ),
            (format!("rect topic list{fleet}"), "list the topics"),
            (
                format!("rect request {two} battery{fleet}"),
                "send a request to a service",
            ),
        ]);
    }
    if args.wifi {
        tries.push((
            "rect wifi silent".to_owned(),
            "jam the Wi-Fi; Bluetooth takes over; end: rect wifi on",
        ));
    }
    tries.extend([
        (
            format!("rect pub greeting hello{fleet}"),
            "publish as the first robot",
        ),
        (
            format!("rect sub '{one}/**'{fleet} --router {}", second.endpoint),
            "receive it at the second robot",
        ),
        (
            "rect air cut".to_owned(),
            "move out of range; back in range: rect air restore",
        ),
    ]);
    let width = tries
        .iter()
        .map(|(command, _)| command.len())
        .max()
        .unwrap_or(0)
        .min(COMMAND_WIDTH);
    for (command, what) in tries {
        rect_terminal::outln!("  {command:width$}  # {what}");
    }
    rect_terminal::outln!("\nCtrl-C stops the simulation.");
}
