//! `ble-relay`: gives the guest's kernel Bluetooth controllers whose radio has a pace and can be made to fail.
//!
//! Each controller is a `/dev/vhci` device towards the kernel and a connection to `btvirt -s` towards the emulation.
//! btvirt does advertising, scanning, connecting and pairing; ACL data goes from one kernel device to the other in here,
//! because btvirt (5.66) has no pace and delivers under the sender's handle, which mixes up an adapter's links as soon
//! as it has two of them. `room.rs` decides, `hci.rs` reads and writes packets, `serve.rs` moves bytes, `ctl.rs` talks
//! to a running relay. Started in the guest by `tests/vm/guest/room`; unit tests: `cargo test -p ble-relay`.

mod ctl;
mod hci;
mod room;
mod serve;

use std::{path::PathBuf, process::ExitCode};

use clap::{Parser, Subcommand};

/// Emulated LE controllers with a radio's pace and faults on request.
#[derive(Parser)]
#[command(version)]
struct Args {
    /// Where requests are taken.
    #[arg(long, global = true, default_value = "/run/ble-relay")]
    control: PathBuf,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run the relay until it is killed.
    Serve(serve::Options),
    /// Send one request to a running relay and print its answer: `add`, `remove hciN`, `swap hciN hciM` (both pulled, and
    /// plugged in the other way round), `list`, `freeze hciN` (radio silence), `thaw hciN`, `drop hciN` (its links are
    /// lost: supervision timeout at both ends), `pace hciN BYTES_PER_S`.
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
