//! Defines the commands of `rect-router` and their arguments. `commands` runs them.
use std::{env, path::PathBuf};

use clap::{Parser, Subcommand};
use rect_core::{
    name::{Name, NameError},
    session::{endpoint, login},
};
use zenoh_link_ble_air::Condition;

/// The commands. Without one, the program runs a router.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Write a robot's configuration, login file and connections file to a folder
    Init(InitArgs),
    /// Check a configuration as the router would read it, without starting anything
    Check(CheckArgs),
    /// Show the status of the robots of the fleet, one line each
    Status(QueryArgs),
    /// Show the connections of one robot or of all robots of the fleet
    Connections(ConnectionsArgs),
    /// Show the robots whose Bluetooth advertisements are received
    Scan(ScanArgs),
    /// Find problems that keep this computer from reaching other robots, and give advice
    Doctor(DoctorArgs),
    /// Run simulated robots on this computer, without Bluetooth, until Ctrl-C
    Sim(SimArgs),
    /// Simulate a Wi-Fi beside the simulated air, or control a running one
    Wifi(WifiArgs),
    /// Print a script for shell completion, e.g. rect-router completion bash
    Completion(CompletionArgs),
    /// Write the manual pages, one for each command
    #[command(hide = true)]
    Man(ManArgs),
}

/// The arguments of `init`.
#[derive(Debug, Parser)]
pub struct InitArgs {
    /// Name of this robot, unique among all robots in range
    pub robot: String,
    /// Name of the fleet, the first part of all keys
    #[arg(long, default_value = "rect")]
    pub fleet: String,
    /// Bluetooth adapter
    #[arg(long, default_value = "hci0")]
    pub adapter: String,
    /// Login file of the team, copied from its first robot [default: create a new one]
    #[arg(long, value_name = "FILE")]
    pub users: Option<PathBuf>,
    /// Write the configuration of a base station, from which the robots' connections may be changed
    #[arg(long)]
    pub base_station: bool,
    /// Router that many fleets share, to connect to; the login file needs the fleet's login there
    #[arg(long, value_name = "ENDPOINT")]
    pub cloud: Option<String>,
    /// Write the configuration of such a router, with a login and a region for each of these fleets
    #[arg(long, value_name = "FLEET", value_delimiter = ',', conflicts_with_all = ["adapter", "base_station", "cloud", "fleet", "users"])]
    pub fleets: Vec<String>,
    /// Folder for the files; a relative path is relative to the current folder
    #[arg(long, value_name = "FOLDER", default_value = "/etc/rect")]
    pub folder: PathBuf,
    /// TCP port on 127.0.0.1 for the programs of this computer
    #[arg(long, default_value_t = 7447, value_parser = clap::value_parser!(u16).range(1..))]
    pub port: u16,
    /// Start the installed service with this configuration, now and at each boot
    #[arg(long)]
    pub start: bool,
}

/// The arguments of `check`.
#[derive(Debug, Parser)]
pub struct CheckArgs {
    /// Configuration file
    #[arg(default_value = "/etc/rect/robot.json5")]
    pub config: String,
}

/// The arguments of commands that query the registry.
#[derive(Debug, Parser)]
pub struct QueryArgs {
    /// Name of the robot; `*` stands for all robots of the fleet
    #[arg(default_value = "*")]
    pub robot: String,
    /// Name of the fleet
    #[arg(long, default_value = "rect")]
    pub fleet: String,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Router to query
    #[command(flatten)]
    pub router: RouterArgs,
}

/// The arguments of `connections`.
#[derive(Debug, Parser)]
pub struct ConnectionsArgs {
    /// Show connections of this method only: ble, tcp, udp, ...
    #[arg(long)]
    pub method: Option<String>,
    /// Robots and router to query
    #[command(flatten)]
    pub query: QueryArgs,
}

/// The arguments for connecting to a running router.
#[derive(Debug, Parser)]
pub struct RouterArgs {
    /// Endpoint of the router to connect to; $RECT_ENDPOINT changes the default
    #[arg(long, value_name = "ENDPOINT", default_value_t = default_router(), value_parser = endpoint::parse)]
    pub router: String,
    /// Login file, used if the router requires a login; $RECT_LOGIN changes the default
    #[arg(long, value_name = "FILE", default_value_os_t = default_login_file())]
    pub users: PathBuf,
}

/// The arguments of `scan`.
#[derive(Debug, Parser)]
pub struct ScanArgs {
    /// Bluetooth adapter
    #[arg(long, default_value = "hci0")]
    pub adapter: String,
    /// Duration of the scan in seconds, 1 to 600
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=600))]
    pub seconds: u64,
    /// Name of the fleet, to distinguish its robots from those of other fleets
    #[arg(long, default_value = "rect")]
    pub fleet: String,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// The arguments of `doctor`.
#[derive(Debug, Parser)]
pub struct DoctorArgs {
    /// Check that the router belongs to this robot [default: any robot]
    #[arg(long = "as", value_name = "ROBOT")]
    pub robot: Option<String>,
    /// Name of the fleet
    #[arg(long, default_value = "rect")]
    pub fleet: String,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Router to query
    #[command(flatten)]
    pub router: RouterArgs,
}

/// The arguments of `sim`.
#[derive(Debug, Parser)]
pub struct SimArgs {
    /// Number of robots, 2 to 8
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(2..=8))]
    pub robots: u16,
    /// Radio conditions: desk, room, wall, edge-of-range or crowded-hall
    #[arg(long, default_value_t = Condition::Room)]
    pub condition: Condition,
    /// Name of the fleet
    #[arg(long, default_value = "rect", value_parser = name)]
    pub fleet: Name,
    /// Port of the first robot's router; the other routers use the ports after it. A port that is in use, or 0, is replaced
    /// by a free one
    #[arg(long, default_value_t = 7447)]
    pub port: u16,
    /// Simulate a Wi-Fi, too: the robots are linked by both, and `rect wifi` controls it
    #[arg(long)]
    pub wifi: bool,
    /// Start only the routers, without programs that publish messages and answer requests
    #[arg(long)]
    pub quiet: bool,
}

const WIFI_EXAMPLE: &str = "\
Example: two robots with Bluetooth and Wi-Fi, in one terminal
  rect sim --wifi
and in another one
  rect connections          # both paths of the link, and which one carries the bulk
  rect wifi silent          # nothing arrives any more, as if the channel were jammed
  rect wifi on";

/// The arguments of `wifi`.
#[derive(Debug, Parser)]
#[command(after_help = WIFI_EXAMPLE)]
pub struct WifiArgs {
    /// `serve`: simulate it until Ctrl-C; `on`, `silent` (nothing arrives) or `off` (connections end): change a running one
    #[arg(value_parser = ["serve", "on", "silent", "off"])]
    pub action: String,
    /// With `serve`: rate in kB/s, of all robots together
    #[arg(long, value_name = "KB_PER_S", default_value_t = 3000, value_parser = clap::value_parser!(u32).range(1..))]
    pub rate: u32,
    /// With `serve`: latency in milliseconds
    #[arg(long, value_name = "MS", default_value_t = 2)]
    pub latency: u64,
    /// With `serve`: how many of 1000 chunks of 4 kB are delayed by 200 ms, because a packet was lost
    #[arg(long, value_name = "PER_1000", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=1000))]
    pub losses: u32,
    /// Socket of the simulated air [default: $RECT_AIR, else that of this user]
    #[arg(long, value_name = "PATH")]
    pub socket: Option<PathBuf>,
}

/// The arguments of `completion`.
#[derive(Debug, Parser)]
pub struct CompletionArgs {
    /// Shell for which to print the script
    pub shell: clap_complete::Shell,
}

/// The arguments of `man`.
#[derive(Debug, Parser)]
pub struct ManArgs {
    /// Folder for the pages, which is created if it does not exist
    pub folder: PathBuf,
}

/// Returns the endpoint of the router for commands that name none.
fn default_router() -> String {
    endpoint::default_router(env::var(endpoint::ROUTER_VARIABLE).ok())
}

fn name(text: &str) -> Result<Name, NameError> {
    Name::new(text)
}

/// Returns the login file for commands that name none.
fn default_login_file() -> PathBuf {
    login::default_file(env::var(login::FILE_VARIABLE).ok()).into()
}
