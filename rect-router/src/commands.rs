//! Owns what `rect-router` does beside being a router: writing a robot's configuration, showing what a running router
//! tells, finding out what is wrong.
mod check;
mod client;
mod connections;
mod doctor;
mod init;
mod manual;
mod scan;
mod service;
mod sim;
mod status;

use std::{env, path::PathBuf, process::ExitCode};

use clap::{Parser, Subcommand};
use rect::{
    core::{
        display, endpoint, login,
        name::{Name, NameError},
        wording,
    },
    terminal::{paint_err, Style},
};
use zenoh_link::ble::radio::sim::Condition;

/// Why a command came to nothing, in words.
type Failure = Box<dyn std::error::Error + Send + Sync>;

/// The commands; without one, it is a router.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Write a robot's configuration, login and list of connections into a folder
    Init(InitArgs),
    /// Read a configuration as the router would, start nothing, and say what is wrong with it
    Check(CheckArgs),
    /// Show which robots of the fleet there are, a line for each
    Status(AskArgs),
    /// Show which connections a robot has, or all robots of the fleet
    Connections(ConnectionsArgs),
    /// Listen for robots that advertise by Bluetooth
    Scan(ScanArgs),
    /// Look for what keeps this computer from talking to others, and say what to do
    Doctor(DoctorArgs),
    /// Start simulated robots to play with, on this computer and without Bluetooth, until Ctrl-C
    Sim(SimArgs),
    /// Print what makes a shell complete these commands, such as: rect-router completion bash
    Completion(CompletionArgs),
    /// Write the manual's pages, one for each command
    #[command(hide = true)]
    Man(ManArgs),
}

/// What `init` takes.
#[derive(Debug, Parser)]
pub struct InitArgs {
    /// This robot's name, unique in the hall
    pub robot: String,
    /// The team's name, the first part of all keys
    #[arg(long, default_value = "rect")]
    pub fleet: String,
    /// The Bluetooth adapter
    #[arg(long, default_value = "hci0")]
    pub adapter: String,
    /// The team's login file, from its first robot; left out, a new one is made
    #[arg(long, value_name = "FILE")]
    pub users: Option<PathBuf>,
    /// For a laptop, from which the robots' settings may be changed
    #[arg(long)]
    pub base_station: bool,
    /// Where to write; a relative one is taken from where the command runs
    #[arg(long, value_name = "FOLDER", default_value = "/etc/rect")]
    pub folder: PathBuf,
    /// The TCP port of 127.0.0.1 for this computer's programs
    #[arg(long, default_value_t = 7447, value_parser = clap::value_parser!(u16).range(1..))]
    pub port: u16,
    /// Start the installed service with it, now and at each boot
    #[arg(long)]
    pub start: bool,
}

/// What `check` takes.
#[derive(Debug, Parser)]
pub struct CheckArgs {
    /// The configuration file
    #[arg(default_value = "/etc/rect/robot.json5")]
    pub config: String,
}

/// Where to ask, and about whom.
#[derive(Debug, Parser)]
pub struct AskArgs {
    /// The robot; left out, all of the fleet
    #[arg(default_value = "*")]
    pub robot: String,
    /// The team's name
    #[arg(long, default_value = "rect")]
    pub fleet: String,
    /// As JSON
    #[arg(long)]
    pub json: bool,
    /// The router
    #[command(flatten)]
    pub router: RouterArgs,
}

/// What `connections` takes.
#[derive(Debug, Parser)]
pub struct ConnectionsArgs {
    /// Of one method only: ble, tcp, udp, ...
    #[arg(long)]
    pub method: Option<String>,
    /// Where, and about whom
    #[command(flatten)]
    pub ask: AskArgs,
}

fn default_login_file() -> PathBuf {
    login::default_file(env::var(login::FILE_VARIABLE).ok()).into()
}

/// How to reach the router.
#[derive(Debug, Parser)]
pub struct RouterArgs {
    /// The router to ask; $RECT_ENDPOINT changes the default
    #[arg(long, value_name = "ENDPOINT", default_value_t = default_router(), value_parser = endpoint::parse)]
    pub router: String,
    /// The login file, where the router asks for a login; $RECT_LOGIN changes the default
    #[arg(long, value_name = "FILE", default_value_os_t = default_login_file())]
    pub users: PathBuf,
}

/// What `scan` takes.
#[derive(Debug, Parser)]
pub struct ScanArgs {
    /// The Bluetooth adapter
    #[arg(long, default_value = "hci0")]
    pub adapter: String,
    /// How long to listen
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=600))]
    pub seconds: u64,
    /// The team's name, to be told from others
    #[arg(long, default_value = "rect")]
    pub fleet: String,
    /// As JSON
    #[arg(long)]
    pub json: bool,
}

/// What `doctor` takes.
#[derive(Debug, Parser)]
pub struct DoctorArgs {
    /// Check that this is the robot of the router [default: any]
    #[arg(long = "as", value_name = "ROBOT")]
    pub robot: Option<String>,
    /// The fleet's name
    #[arg(long, default_value = "rect")]
    pub fleet: String,
    /// As JSON
    #[arg(long)]
    pub json: bool,
    /// The router
    #[command(flatten)]
    pub router: RouterArgs,
}

/// What `sim` takes.
#[derive(Debug, Parser)]
pub struct SimArgs {
    /// How many robots, 2 to 8
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(2..=8))]
    pub robots: u16,
    /// How good the radio is: desk, room, wall, edge-of-range or crowded-hall
    #[arg(long, default_value_t = Condition::Room)]
    pub condition: Condition,
    /// The fleet's name
    #[arg(long, default_value = "rect", value_parser = name)]
    pub fleet: Name,
    /// The port of the first robot's router, which others follow; one that is taken, or 0, is replaced by a free one
    #[arg(long, default_value_t = 7447)]
    pub port: u16,
    /// Start the routers alone, without programs that publish and answer
    #[arg(long)]
    pub quiet: bool,
}

/// What `completion` takes.
#[derive(Debug, Parser)]
pub struct CompletionArgs {
    /// Which shell
    pub shell: clap_complete::Shell,
}

/// What `man` takes.
#[derive(Debug, Parser)]
pub struct ManArgs {
    /// A folder that is there
    pub folder: PathBuf,
}

/// Runs one; what is wrong is said on stderr.
pub fn run(command: &Command) -> ExitCode {
    let done = match command {
        Command::Init(args) => init::run(args).map(|()| ExitCode::SUCCESS),
        Command::Check(args) => check::run(args).map(|()| ExitCode::SUCCESS),
        Command::Status(args) => status::run(args).map(|()| ExitCode::SUCCESS),
        Command::Connections(args) => connections::run(args).map(|()| ExitCode::SUCCESS),
        Command::Scan(args) => scan::run(args).map(|()| ExitCode::SUCCESS),
        Command::Doctor(args) => doctor::run(args),
        Command::Sim(args) => sim::run(args),
        Command::Completion(args) => {
            manual::complete(args);
            Ok(ExitCode::SUCCESS)
        }
        Command::Man(args) => manual::write(args).map(|()| ExitCode::SUCCESS),
    };
    done.unwrap_or_else(|error| {
        // Parts of it may come from another robot.
        let text = display::line(&wording::with_causes(error.as_ref())).into_owned();
        let program = format!("{}:", program());
        rect::errln!("{} {text}", paint_err(Style::Wrong, &program));
        ExitCode::FAILURE
    })
}

/// As what a person started this program: `rect` becomes it for some of its commands.
fn program() -> &'static str {
    let name = env::args_os().next();
    if name.is_some_and(|name| name == "rect") {
        "rect"
    } else {
        "rect-router"
    }
}

/// The router of commands that name none.
fn default_router() -> String {
    endpoint::default_router(env::var(endpoint::ROUTER_VARIABLE).ok())
}

fn name(text: &str) -> Result<Name, NameError> {
    Name::new(text)
}
