//! RECT, the Robot Extensible Communication Toolkit.
//! The `rect` command. Owns its arguments and its exit status; what each command does is in a module of its own.
mod air;
mod ask;
mod bench;
mod completion;
mod configure;
mod dictionary;
mod doctor;
mod listen;
mod manual;
mod payload;
mod registry;
mod session;
mod shown;
mod span;
mod speak;
mod stream;
mod transfer;

use std::{future::Future, process::ExitCode};

use clap::{Parser, Subcommand};

const EXAMPLE: &str = "\
Examples, at a robot whose router runs (rect-router; `rect-router init wombat-1` makes its configuration):
  rect pub arm/angle 12.5                  # says it to all
  rect sub '*/arm/*'                       # what any robot says about its arm
  rect send wombat-2 grab '{\"force\": 3}'   # to one robot alone
  rect request wombat-2 battery            # asks a service
  rect stream watch wombat-2 camera        # its pictures, as fresh as the link allows
  rect transfer send wombat-2 map.bin      # a file of any size
  rect peers                               # who is there
  rect connect base tcp 10.0.0.2 --port 7447  # a connection by that name
  rect bench wombat-2                      # how good the link to it is (`rect bench --serve` there)";

/// The Robot Extensible Communication Toolkit: robots that talk over Bluetooth LE, TCP and UDP.
#[derive(Parser)]
#[command(name = "rect", version, after_help = EXAMPLE)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Pub(speak::PubArguments),
    Send(speak::SendArguments),
    Sub(listen::SubArguments),
    Request(ask::RequestArguments),
    Serve(ask::ServeArguments),
    Stream(stream::StreamArguments),
    Transfer(transfer::TransferArguments),
    Peers(registry::PeersArguments),
    Connections(registry::ConnectionsArguments),
    Connect(configure::ConnectArguments),
    Disconnect(configure::DisconnectArguments),
    Bench(bench::BenchArguments),
    Doctor(doctor::DoctorArguments),
    Dictionary(dictionary::DictionaryArguments),
    Air(air::AirArguments),
    Completion(completion::CompletionArguments),
    Man(manual::ManArguments),
}

/// Why a command failed, for a person.
type Failure = Box<dyn std::error::Error + Send + Sync>;
type Done = Result<ExitCode, Failure>;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_env("RUST_LOG")
                .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn,zenoh=error")),
        )
        .with_writer(std::io::stderr)
        .init();
    let done = match arguments.command {
        Command::Air(arguments) => air::run(arguments)
            .map(|()| ExitCode::SUCCESS)
            .map_err(Failure::from),
        Command::Completion(arguments) => Ok(completion::run(&arguments)),
        Command::Man(arguments) => manual::run(&arguments),
        Command::Dictionary(arguments) => dictionary::run(arguments),
        Command::Pub(arguments) => wait(speak::publish(arguments)),
        Command::Send(arguments) => wait(speak::send(arguments)),
        Command::Sub(arguments) => wait(listen::run(arguments)),
        Command::Request(arguments) => wait(ask::request(arguments)),
        Command::Serve(arguments) => wait(ask::serve(arguments)),
        Command::Stream(arguments) => wait(stream::run(arguments)),
        Command::Transfer(arguments) => wait(transfer::run(arguments)),
        Command::Peers(arguments) => wait(registry::peers(arguments)),
        Command::Connections(arguments) => wait(registry::connections(arguments)),
        Command::Connect(arguments) => wait(configure::connect(arguments)),
        Command::Disconnect(arguments) => wait(configure::disconnect(arguments)),
        Command::Bench(arguments) => wait(bench::run(arguments)),
        Command::Doctor(arguments) => wait(doctor::run(arguments)),
    };
    match done {
        Ok(status) => status,
        Err(error) => {
            eprintln!("rect: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Runs it to its end, or to Ctrl-C.
fn wait(command: impl Future<Output = Done>) -> Done {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    let done = runtime.block_on(async {
        tokio::select! {
            done = command => done,
            interrupted = tokio::signal::ctrl_c() => {
                interrupted?;
                // As shells tell that a program was interrupted.
                Ok(ExitCode::from(130))
            }
        }
    });
    runtime.shutdown_background();
    done
}
