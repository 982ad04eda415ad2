//! Implements `rect air`, which serves the simulated air to the programs of this computer, and controls a running one.
use std::{
    fs::File,
    io::{self, Write},
    path::PathBuf,
};

use crate::{choice, duration::DurationArgument};
use clap::{Args, Subcommand, ValueEnum};
use rect_core::text::display::line;
use rect_terminal::{self as terminal, Table};
use tokio::signal::unix::{signal, SignalKind};
use zenoh_link_ble_air::{
    AirOptions, AirServer, AirStatus, Condition, Control, ControlError, LlPayload, Phy, ServeError,
};

/// The values of `--pdu`.
const PAYLOADS: [LlPayload; 2] = [LlPayload::Bytes27, LlPayload::Bytes251];

const EXAMPLE: &str = "\
Example: two robots on one computer, without Bluetooth
  rect air --condition room &                    # the air, which programs find automatically
  rect-router -l ble/sim-1#name=wombat-1 &       # adapters named sim... use the air
  rect-router -l ble/sim-2#name=wombat-2 -e ble/wombat-1#adapter=sim-2 &
  rect air status                                # adapters, links, transmitted bytes
  rect air cut; sleep 5; rect air restore        # moves all adapters out of range and back
  rect air condition edge-of-range               # desk, room, wall, edge-of-range, crowded-hall";

/// Simulate Bluetooth LE: serve the simulated air (the default), or control a running one
///
/// All programs of this user on this computer that use an adapter named `sim...` share the air. Its airtime, range, loss and
/// timing are modelled on Bluetooth LE.
#[derive(Args)]
#[command(after_help = EXAMPLE, args_conflicts_with_subcommands = true)]
pub struct AirArguments {
    #[command(subcommand)]
    command: Option<AirCommand>,
    #[command(flatten)]
    serve: ServeArguments,
}

#[derive(Subcommand)]
enum AirCommand {
    /// Serve the air in the foreground, until Ctrl-C
    Serve(ServeArguments),
    /// Move all adapters out of range of each other
    Cut(SocketArgument),
    /// Move all adapters back into range
    Restore(SocketArgument),
    /// Change the radio condition
    Condition {
        /// The radio condition
        #[arg(value_parser = choice::of(&Condition::ALL))]
        condition: Condition,
        #[command(flatten)]
        socket: SocketArgument,
    },
    /// Switch an adapter on or off
    Power {
        /// The name of the adapter, such as sim-1
        adapter: String,
        /// The new state
        switch: Switch,
        #[command(flatten)]
        socket: SocketArgument,
    },
    /// Show the adapters, the links, and the transmitted bytes
    Status {
        /// Print JSON
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        socket: SocketArgument,
    },
}

#[derive(Args)]
struct ServeArguments {
    /// The radio condition
    #[arg(long, default_value_t = Condition::Room, value_parser = choice::of(&Condition::ALL))]
    condition: Condition,
    /// The connection interval, 7.5ms to 4s
    #[arg(long, default_value = "30ms")]
    interval: DurationArgument,
    /// The physical layer
    #[arg(long, default_value_t = Phy::Le1M, value_parser = choice::of(&Phy::ALL))]
    phy: Phy,
    /// The link-layer payload in bytes; a Raspberry Pi 3B has 27
    #[arg(long, default_value_t = LlPayload::Bytes251, value_parser = choice::of(&PAYLOADS))]
    pdu: LlPayload,
    /// The supervision timeout: time without a packet after which a link is lost
    #[arg(long, default_value = "2s")]
    supervision: DurationArgument,
    /// The seed of the random losses; the same seed gives the same losses
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write what a sniffer would receive to this file: a line for each SDU, with the seconds and the bytes in hexadecimal
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    #[command(flatten)]
    socket: SocketArgument,
}

#[derive(Args)]
struct SocketArgument {
    /// The socket of the air [default: $RECT_AIR, else rect-air.sock in $XDG_RUNTIME_DIR, else /tmp/rect-air-<uid>.sock]
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Switch {
    On,
    Off,
}

/// The error of `rect air`.
#[derive(Debug, thiserror::Error)]
pub enum AirError {
    /// The air cannot be served.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// The running air cannot be reached, or rejected the command.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// The runtime cannot be started.
    #[error("cannot start: {0}")]
    System(#[from] io::Error),
    /// The status cannot be written as JSON.
    #[error("cannot write the status: {0}")]
    Json(#[from] serde_json::Error),
}

/// Runs `rect air`.
pub fn run(arguments: AirArguments) -> Result<(), AirError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let command = arguments
        .command
        .unwrap_or(AirCommand::Serve(arguments.serve));
    runtime.block_on(async {
        match command {
            AirCommand::Serve(arguments) => serve(arguments).await,
            AirCommand::Cut(socket) => {
                control(socket, Control::Cut).await?;
                done("all adapters are out of range of each other; `rect air restore` moves them back");
                Ok(())
            }
            AirCommand::Restore(socket) => {
                control(socket, Control::Restore).await?;
                done("all adapters are in range of each other");
                Ok(())
            }
            AirCommand::Condition { condition, socket } => {
                control(socket, Control::Condition(condition)).await?;
                done(&format!("the radio condition is {condition}"));
                Ok(())
            }
            AirCommand::Power {
                adapter,
                switch,
                socket,
            } => {
                let on = matches!(switch, Switch::On);
                let text = format!("{adapter} is switched {}", if on { "on" } else { "off" });
                control(socket, Control::Power { adapter, on }).await?;
                done(&text);
                Ok(())
            }
            AirCommand::Status { json, socket } => status(socket, json).await,
        }
    })
}

async fn serve(arguments: ServeArguments) -> Result<(), AirError> {
    let options = AirOptions {
        seed: arguments.seed,
        condition: arguments.condition,
        phy: arguments.phy,
        pdu: arguments.pdu,
        interval: arguments.interval.0,
        supervision_timeout: arguments.supervision.0,
        ..AirOptions::default()
    };
    let condition = options.condition;
    let record = arguments.record.map(File::create).transpose()?;
    // Signals are handled before the socket exists, so that no signal can leave it behind.
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let server = AirServer::bind(&arguments.socket.path(), options)?;
    if let Some(mut file) = record {
        server.air().sniff(move |at, sdu| {
            let hex: String = sdu.iter().map(|byte| format!("{byte:02x}")).collect();
            // A full disk ends the record and not the air.
            let _ = writeln!(file, "{:.6} {hex}", at.as_secs_f64());
        });
    }
    // The air is served even if the standard output is closed.
    let _ = rect_terminal::try_write(format_args!(
        "simulated air ({condition}) at {}: listen on ble/sim-1, or see `rect air --help`",
        server.path().display()
    ));
    // After this, the server is dropped, which removes its socket.
    tokio::select! {
        () = server.serve() => {}
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
    Ok(())
}

async fn control(socket: SocketArgument, command: Control) -> Result<(), AirError> {
    zenoh_link_ble_air::control(&socket.path(), command).await?;
    Ok(())
}

/// Prints what has been changed. It is changed even if nobody reads that.
fn done(what: &str) {
    let _ = rect_terminal::try_write(format_args!("{}", line(what)));
}

async fn status(socket: SocketArgument, json: bool) -> Result<(), AirError> {
    let Some(status) = zenoh_link_ble_air::control(&socket.path(), Control::Status).await? else {
        return Ok(());
    };
    if json {
        terminal::json(&status)?;
    } else {
        show(&status);
    }
    Ok(())
}

fn show(status: &AirStatus) {
    let cut = if status.is_cut { ", cut" } else { "" };
    rect_terminal::outln!("{}{cut}, {} phy\n", status.condition, status.phy);
    let mut adapters = Table::new(&[
        "ADAPTER", "STATE", "BYTES", "?ADDRESS", "?SCANS", "?LISTENS", "?PACKETS", "?REPEATS",
        "?BUSY",
    ]);
    for adapter in &status.adapters {
        let listens: Vec<_> = adapter.listens.iter().map(u16::to_string).collect();
        let stats = &adapter.stats;
        adapters.row(vec![
            adapter.name.as_str().into(),
            adapter.state.as_str().into(),
            stats.bytes_on_air.to_string().into(),
            adapter.address.as_str().into(),
            if adapter.scans { "yes" } else { "" }.into(),
            listens.join(",").into(),
            stats.pdus.to_string().into(),
            stats.repeats.to_string().into(),
            format!("{:.1} s", stats.busy.as_secs_f64()).into(),
        ]);
    }
    adapters.print();
    if status.links.is_empty() {
        rect_terminal::outln!("\nno links");
        return;
    }
    rect_terminal::outln!("");
    for link in &status.links {
        rect_terminal::outln!(
            "{} -> {}: {} channel(s), {} and {} bytes waiting",
            line(&link.central),
            line(&link.peripheral),
            link.channels,
            link.queued_bytes[0],
            link.queued_bytes[1]
        );
    }
}

impl SocketArgument {
    fn path(self) -> PathBuf {
        self.socket.unwrap_or_else(zenoh_link_ble_air::socket_path)
    }
}
