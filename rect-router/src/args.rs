//! Defines the flags of `rect-router`: those of zenohd 1.10.2 with the same meaning, and `--login-as`.
mod command;

use clap::{builder::PossibleValuesParser, Parser};

pub use self::command::{
    CheckArgs, Command, CompletionArgs, ConnectionsArgs, DoctorArgs, InitArgs, ManArgs, QueryArgs,
    RouterArgs, ScanArgs, SimArgs, WifiArgs,
};
use crate::version;

/// Parses the command line. Invalid flags end the program with status 2 and a message on stderr.
pub fn parse() -> Args {
    Args::parse()
}

/// Describes the exit statuses in `--help`.
const EXIT_STATUS: &str = "\
Exit status of the router:
  0    stopped by SIGTERM or SIGINT (Ctrl-C) after its links were closed, at most 5 s later
  1    it could not start; stderr has the reason
  2    invalid flags
  130, 143
       a second SIGINT or SIGTERM ended it before its links were closed
A command, such as `check`, exits with 0 on success, 1 if it failed or found a problem, and 2 if its flags are invalid.";

/// RECT's router. Accepts zenohd's flags and configuration files, and `ble/` endpoints.
#[derive(Debug, Parser)]
#[command(name = "rect-router", version = version::SHORT, long_version = version::long())]
#[command(args_conflicts_with_subcommands = true, after_long_help = EXIT_STATUS)]
pub struct Args {
    /// Run a command instead of the router
    #[command(subcommand)]
    pub command: Option<Command>,

    /// Configuration file in JSON5 (.json5, .json) or YAML (.yaml, .yml)
    #[arg(short, long, value_name = "PATH")]
    pub config: Option<String>,

    /// Endpoint to listen on, e.g. `tcp/127.0.0.1:7447` or `ble/hci0#name=wombat-1`; may be repeated
    #[arg(short, long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,

    /// Endpoint to connect to, e.g. `tcp/192.168.1.5:7447` or `ble/wombat-2`; may be repeated
    #[arg(short = 'e', long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,

    /// Identifier of this router, unique in the network: up to 32 lowercase hexadecimal digits, not starting with 0
    /// [default: random]
    #[arg(short, long)]
    pub id: Option<String>,

    /// Plugin to load, required for the start: NAME (found as libzenoh_plugin_NAME.so) or NAME:PATH; may be repeated
    #[arg(short = 'P', long, value_name = "NAME[:PATH]")]
    pub plugin: Vec<String>,

    /// Folder in which to search for plugins; may be repeated
    #[arg(long, value_name = "PATH")]
    pub plugin_search_dir: Vec<String>,

    /// Do not add timestamps to messages that have none
    #[arg(long)]
    pub no_timestamp: bool,

    /// Do not answer multicast scouting messages
    #[arg(long)]
    pub no_multicast_scouting: bool,

    /// Load the REST plugin and serve HTTP on PORT or ADDRESS:PORT; `none` does not load it
    #[arg(long, value_name = "SOCKET")]
    pub rest_http_port: Option<String>,

    /// Set a part of the configuration: KEY:VALUE, with VALUE in JSON5; an empty KEY sets the whole configuration; may be
    /// repeated. E.g. `--cfg 'startup/subscribe:["demo/**"]'`. An unknown KEY or an invalid VALUE is an error (zenohd warns
    /// and starts without the setting)
    #[arg(long, value_name = "KEY:VALUE")]
    pub cfg: Vec<String>,

    /// Access of others to the admin space: read, write, both or none [default: r]
    #[arg(long, value_parser = PossibleValuesParser::new(["r", "w", "rw", "none"]))]
    pub adminspace_permissions: Option<String>,

    /// Log in as this user when dialling, with the password from `transport/auth/usrpwd/dictionary_file`
    /// (not a flag of zenohd, whose configuration requires the password a second time)
    #[arg(long, value_name = "USER")]
    pub login_as: Option<String>,
}
