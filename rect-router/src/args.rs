//! The flags: zenohd 1.10.2's, each with zenohd's meaning, and `--login-as`.

use clap::{builder::PossibleValuesParser, Parser};

use crate::{commands::Command, version};

/// Reads the command line; wrong flags end the program with status 2 and a word on what is right.
pub fn parse() -> Args {
    Args::parse()
}

/// The exit statuses, for `--help`.
const EXIT_STATUS: &str = "\
Exit status of the router:
  0    after SIGTERM or SIGINT (Ctrl-C), once its links are closed, after 5 s at the latest
  1    it could not start; the reason is on stderr
  2    the flags are wrong
  130, 143
       a second SIGINT or SIGTERM ended it before its links were closed
A command, such as `check`, exits with 0, with 1 if it failed or found something wrong, and with 2 if its flags are wrong.";

/// RECT's router. Takes zenohd's flags and configuration files, and `ble/` endpoints.
#[derive(Debug, Parser)]
#[command(name = "rect-router", version = version::SHORT, long_version = version::long())]
#[command(args_conflicts_with_subcommands = true, after_long_help = EXIT_STATUS)]
pub struct Args {
    /// Something else than being a router
    #[command(subcommand)]
    pub command: Option<Command>,

    /// The configuration file: JSON5 (.json5, .json) or YAML (.yaml, .yml)
    #[arg(short, long, value_name = "PATH")]
    pub config: Option<String>,

    /// Where to listen for others, e.g. `tcp/127.0.0.1:7447` or `ble/hci0#name=wombat-1`; may be repeated
    #[arg(short, long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,

    /// Whom to connect to, e.g. `tcp/192.168.1.5:7447` or `ble/wombat-2`; may be repeated
    #[arg(short = 'e', long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,

    /// This router's identifier: up to 32 lowercase hexadecimal digits, not starting with 0, unique in the network
    /// [default: random]
    #[arg(short, long)]
    pub id: Option<String>,

    /// A plugin that must be loaded: NAME (found as libzenoh_plugin_NAME.so) or NAME:PATH; may be repeated
    #[arg(short = 'P', long, value_name = "NAME[:PATH]")]
    pub plugin: Vec<String>,

    /// Where to look for plugins; may be repeated
    #[arg(long, value_name = "PATH")]
    pub plugin_search_dir: Vec<String>,

    /// Do not add a timestamp to data that has none
    #[arg(long)]
    pub no_timestamp: bool,

    /// Do not answer to multicast scouting
    #[arg(long)]
    pub no_multicast_scouting: bool,

    /// Load the REST plugin and serve HTTP there: PORT or ADDRESS:PORT, or `none`
    #[arg(long, value_name = "SOCKET")]
    pub rest_http_port: Option<String>,

    /// Set a part of the configuration: KEY:VALUE, VALUE in JSON5; an empty KEY is the whole configuration; may be
    /// repeated. E.g. `--cfg 'startup/subscribe:["demo/**"]'`. An unknown KEY or a wrong VALUE is an error (zenohd warns and
    /// starts without it)
    #[arg(long, value_name = "KEY:VALUE")]
    pub cfg: Vec<String>,

    /// What others may do in the admin space [default: r]
    #[arg(long, value_parser = PossibleValuesParser::new(["r", "w", "rw", "none"]))]
    pub adminspace_permissions: Option<String>,

    /// Log in to others as this user of `transport/auth/usrpwd/dictionary_file`, with the password found there
    /// (not a flag of zenohd, whose configuration wants the password a second time)
    #[arg(long, value_name = "USER")]
    pub login_as: Option<String>,
}
