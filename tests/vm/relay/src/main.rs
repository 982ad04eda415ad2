//! Provides the guest's kernel with Bluetooth controllers whose radio has a rate limit and injectable faults.
//!
//! Each controller consists of a `/dev/vhci` device towards the kernel and a connection to `btvirt -s` towards the
//! emulation. btvirt handles advertising, scanning, connecting and pairing. This program carries ACL data from one
//! kernel device to the other, because btvirt (5.66) has no rate limit and delivers data under the sender's handle,
//! which confuses the links of an adapter that has more than one. `room.rs` contains the logic, `hci.rs` parses and
//! builds packets, `serve.rs` moves bytes, and `ctl.rs` sends requests to a running relay. Started in the guest by
//! `tests/vm/guest/room`; unit tests: `cargo test -p ble-relay`.

mod ctl;
mod hci;
mod room;
mod serve;

use std::{path::PathBuf, process::ExitCode};

use clap::{Parser, Subcommand};

/// Emulates LE controllers with a rate limit and injectable faults.
#[derive(Parser)]
#[command(version)]
struct Args {
    /// Path of the control socket.
    #[arg(long, global = true, default_value = "/run/ble-relay")]
    control: PathBuf,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run the relay until it is killed.
    Serve(serve::Options),
    /// Send one request to a running relay and print its reply: `add`, `remove hciN`, `swap hciN hciM` (unplugs both
    /// and plugs them in in the opposite order), `list`, `freeze hciN` (radio silence), `thaw hciN`, `drop hciN` (ends
    /// its links with a supervision timeout at both ends), `pace hciN BYTES_PER_S` (rate limit; 0: none).
    Ctl { request: Vec<String> },
}

fn main() -> ExitCode {
    let args = Args::parse();
    let result = match args.command {
        Command::Serve(options) => serve::serve(&options, &args.control).map_err(|e| e.to_string()),
        Command::Ctl { request } => {
            ctl::send(&args.control, &request.join(" ")).map_err(|e| e.to_string())
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("ble-relay: {reason}");
            ExitCode::FAILURE
        }
    }
}
