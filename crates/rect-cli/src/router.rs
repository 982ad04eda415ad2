//! Implements the commands of `rect` that `rect-router` executes. The process of `rect` is replaced by that program,
//! which is installed beside it or on the PATH.
use std::{
    env,
    ffi::OsString,
    io::{self, ErrorKind},
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::Command,
};

use clap::Args;
use rect_terminal as terminal;

use crate::{endpoint, Done, Failure};

const ROUTER: &str = "rect-router";
/// The environment variable with the path of the `rect-router` to use instead of the one beside this program.
const VARIABLE: &str = "RECT_ROUTER";

/// Write the configuration, login file and connections file of a robot to a folder; see `rect init --help`
#[derive(Args)]
#[command(disable_help_flag = true)]
pub struct InitArguments {
    /// The name of the robot, and options
    #[arg(
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "ROBOT"
    )]
    arguments: Vec<OsString>,
}

/// Check a configuration as the router would read it, without starting anything
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

/// Run simulated robots on this computer, without Bluetooth, until Ctrl-C
#[derive(Args)]
#[command(disable_help_flag = true)]
pub struct SimArguments {
    /// The options; see `rect sim --help`
    #[arg(
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "OPTIONS"
    )]
    arguments: Vec<OsString>,
}

/// Simulate a Wi-Fi beside the simulated air, or control a running one; see `rect wifi --help`
#[derive(Args)]
#[command(disable_help_flag = true)]
pub struct WifiArguments {
    /// `serve`, `on`, `silent` or `off`, and options
    #[arg(
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "ACTION"
    )]
    arguments: Vec<OsString>,
}

/// The router to query.
#[derive(Args)]
struct AtArguments {
    /// The router [default: $RECT_ENDPOINT, else tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT", value_parser = endpoint)]
    router: Option<String>,
    /// The login file, if the router requires a login
    #[arg(long, value_name = "FILE")]
    users: Option<PathBuf>,
    /// The name of the fleet
    #[arg(long, default_value = "rect")]
    fleet: String,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Show the state of the robots of the fleet, one line for each
#[derive(Args)]
pub struct StatusArguments {
    /// The robot [default: all robots of the fleet]
    robot: Option<String>,
    #[command(flatten)]
    at: AtArguments,
}

/// Scan for robots that advertise over Bluetooth
#[derive(Args)]
pub struct ScanArguments {
    /// The Bluetooth adapter
    #[arg(long, default_value = "hci0")]
    adapter: String,
    /// How long to scan, 1 to 600 seconds
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// The name of the fleet, to distinguish its robots from others
    #[arg(long, default_value = "rect")]
    fleet: String,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Find problems that prevent communication with other robots, and suggest solutions
#[derive(Args)]
pub struct DoctorArguments {
    /// Check that the router belongs to this robot [default: any robot]
    #[arg(long = "as", value_name = "ROBOT")]
    robot: Option<String>,
    #[command(flatten)]
    at: AtArguments,
}

/// Runs `rect init`.
pub fn init(arguments: InitArguments) -> Done {
    become_router("init", arguments.arguments)
}

/// Runs `rect check`.
pub fn check(arguments: CheckArguments) -> Done {
    become_router("check", arguments.arguments)
}

/// Runs `rect sim`.
pub fn sim(arguments: SimArguments) -> Done {
    become_router("sim", arguments.arguments)
}

/// Runs `rect wifi`.
pub fn wifi(arguments: WifiArguments) -> Done {
    become_router("wifi", arguments.arguments)
}

/// Runs `rect status`.
pub fn status(arguments: StatusArguments) -> Done {
    let robot = arguments.robot.map(OsString::from);
    become_router("status", robot.into_iter().chain(arguments.at.passed_on()))
}

/// Runs `rect scan`.
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

/// Runs `rect doctor`.
pub fn doctor(arguments: DoctorArguments) -> Done {
    let robot = arguments.robot.map(|robot| ["--as".into(), robot.into()]);
    let robot = robot.into_iter().flatten();
    become_router("doctor", robot.chain(arguments.at.passed_on()))
}

/// Writes the manual pages of `init`, `check`, `sim` and `wifi`.
pub fn manual(folder: &Path) -> Done {
    become_router("man", [folder.as_os_str().to_owned()])
}

impl AtArguments {
    /// Returns the arguments in the form in which `rect-router` parses them.
    fn passed_on(self) -> impl Iterator<Item = OsString> {
        let router = self.router.map(|router| ["--router".into(), router.into()]);
        let users = self.users.map(|users| ["--users".into(), users.into()]);
        let fleet = [["--fleet".into(), self.fleet.into()]];
        let options = router.into_iter().chain(users).chain(fleet).flatten();
        options.chain(self.json.then(|| "--json".into()))
    }
}

/// Replaces this process by `rect-router`, which uses the name `rect` in its output. Returns only if that fails.
fn become_router(command: &str, arguments: impl IntoIterator<Item = OsString>) -> Done {
    let program = program();
    let mut router = Command::new(&program);
    router.arg0("rect").arg(command).args(arguments);
    if let Some((name, value)) = terminal::colours_by_environment() {
        router.env_remove("NO_COLOR").env(name, value);
    }
    let error = router.exec();
    Err(not_started(command, &program, &error))
}

/// Returns the path of `rect-router`: the one that the environment selects, else the one beside this program, else the
/// one on the PATH.
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

fn not_started(command: &str, program: &Path, error: &io::Error) -> Failure {
    let program = program.display();
    if error.kind() == ErrorKind::NotFound {
        return format!(
            "`rect {command}` requires {ROUTER}, and {program} is not installed: install it beside `rect` or on the PATH, \
             or set the environment variable {VARIABLE} to its path"
        )
        .into();
    }
    format!("`rect {command}` cannot start {program}: {error}").into()
}
