//! Owns the commands of `rect` that `rect-router` does, which is beside it or on the PATH: `rect` becomes that program.
use std::{
    env,
    ffi::OsString,
    io::{self, ErrorKind},
    os::unix::process::CommandExt,
    path::PathBuf,
    process::Command,
};

use clap::Args;
use rect::terminal;

use crate::{endpoint, Done, Failure};

const ROUTER: &str = "rect-router";
/// Names another rect-router than the one beside this program.
const VARIABLE: &str = "RECT_ROUTER";

/// Write a robot's configuration, login and list of connections into a folder; `rect init --help` has the options
#[derive(Args)]
#[command(disable_help_flag = true)]
pub struct InitArguments {
    /// The robot's name, and options
    #[arg(
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "ROBOT"
    )]
    arguments: Vec<OsString>,
}

/// Read a configuration as the router would, start nothing, and report what is wrong with it
#[derive(Args)]
#[command(disable_help_flag = true)]
pub struct CheckArguments {
    /// The configuration file
    #[arg(
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "CONFIG"
    )]
    arguments: Vec<OsString>,
}

/// Start simulated robots to play with, on this computer and without Bluetooth, until Ctrl-C
#[derive(Args)]
#[command(disable_help_flag = true)]
pub struct SimArguments {
    /// `rect sim --help` has the options
    #[arg(
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "OPTIONS"
    )]
    arguments: Vec<OsString>,
}

/// Which router to ask.
#[derive(Args)]
struct AtArguments {
    /// The router [default: $RECT_ENDPOINT, else tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT", value_parser = endpoint)]
    router: Option<String>,
    /// The login file, if the router requires a login
    #[arg(long, value_name = "FILE")]
    users: Option<PathBuf>,
    /// The fleet's name
    #[arg(long, default_value = "rect")]
    fleet: String,
    /// As JSON
    #[arg(long)]
    json: bool,
}

/// Show the robots of the fleet at a glance, a line for each
#[derive(Args)]
pub struct StatusArguments {
    /// The robot [default: all of the fleet]
    robot: Option<String>,
    #[command(flatten)]
    at: AtArguments,
}

/// Look for robots that advertise by Bluetooth
#[derive(Args)]
pub struct ScanArguments {
    /// The Bluetooth adapter
    #[arg(long, default_value = "hci0")]
    adapter: String,
    /// How long to scan, 1 to 600
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// The fleet's name, to tell its robots from others
    #[arg(long, default_value = "rect")]
    fleet: String,
    /// As JSON
    #[arg(long)]
    json: bool,
}

/// Find what keeps programs here from talking to other robots, and report what to do
#[derive(Args)]
pub struct DoctorArguments {
    /// Check that this is the robot of the router [default: any]
    #[arg(long = "as", value_name = "ROBOT")]
    robot: Option<String>,
    #[command(flatten)]
    at: AtArguments,
}

/// `rect init`.
pub fn init(arguments: InitArguments) -> Done {
    become_router("init", arguments.arguments)
}

/// `rect check`.
pub fn check(arguments: CheckArguments) -> Done {
    become_router("check", arguments.arguments)
}

/// `rect sim`.
pub fn sim(arguments: SimArguments) -> Done {
    become_router("sim", arguments.arguments)
}

/// `rect status`.
pub fn status(arguments: StatusArguments) -> Done {
    let robot = arguments.robot.map(OsString::from);
    become_router("status", robot.into_iter().chain(arguments.at.passed_on()))
}

/// `rect scan`.
pub fn scan(arguments: ScanArguments) -> Done {
    let ScanArguments {
        adapter,
        seconds,
        fleet,
        json,
    } = arguments;
    let seconds = seconds.to_string();
    let options = [
        ("--adapter", adapter),
        ("--seconds", seconds),
        ("--fleet", fleet),
    ];
    let options = options
        .into_iter()
        .flat_map(|(name, value)| [name.into(), value.into()]);
    become_router("scan", options.chain(json.then(|| "--json".into())))
}

/// `rect doctor`.
pub fn doctor(arguments: DoctorArguments) -> Done {
    let robot = arguments.robot.map(|robot| ["--as".into(), robot.into()]);
    let robot = robot.into_iter().flatten();
    become_router("doctor", robot.chain(arguments.at.passed_on()))
}

impl AtArguments {
    fn passed_on(self) -> impl Iterator<Item = OsString> {
        let router = self.router.map(|router| ["--router".into(), router.into()]);
        let users = self.users.map(|users| ["--users".into(), users.into()]);
        let fleet = [["--fleet".into(), self.fleet.into()]];
        let options = router.into_iter().chain(users).chain(fleet).flatten();
        options.chain(self.json.then(|| "--json".into()))
    }
}

/// Replaces this program by rect-router, which calls itself `rect` in what it prints.
fn become_router(command: &str, arguments: impl IntoIterator<Item = OsString>) -> Done {
    let program = program();
    let mut router = Command::new(&program);
    router.arg0("rect").arg(command).args(arguments);
    if let Some((name, value)) = terminal::colours_by_environment() {
        router.env_remove("NO_COLOR").env(name, value);
    }
    // It returns only if it fails.
    let error = router.exec();
    Err(not_started(command, &program, &error))
}

/// The router named by the environment, else the one beside this program, else the one on the PATH.
fn program() -> PathBuf {
    if let Some(named) = env::var_os(VARIABLE).filter(|named| !named.is_empty()) {
        return named.into();
    }
    let beside = env::current_exe()
        .ok()
        .map(|this| this.with_file_name(ROUTER));
    let beside = beside.filter(|program| program.exists());
    beside.unwrap_or_else(|| ROUTER.into())
}

fn not_started(command: &str, program: &std::path::Path, error: &io::Error) -> Failure {
    let program = program.display();
    if error.kind() == ErrorKind::NotFound {
        return format!(
            "`rect {command}` needs {ROUTER}, and {program} is not there: install it beside `rect` or on the PATH, \
             or name it by {VARIABLE}"
        )
        .into();
    }
    format!("`rect {command}` cannot start {program}: {error}").into()
}
