//! RECT, the Robot Extensible Communication Toolkit.
//! The `rect` command. Owns its arguments and its exit status; what each command does is in a module of its own.
mod air;
mod ask;
mod bench;
mod clock;
mod completion;
mod configure;
mod dictionary;
mod listen;
mod manual;
mod payload;
mod registry;
mod router;
mod session;
mod shown;
mod span;
mod speak;
mod stream;
mod topic;
mod transfer;

use std::{future::Future, process::ExitCode};

use clap::{Parser, Subcommand, ValueEnum};
use rect::{
    core::display::paragraph,
    terminal::{choose_colours, colours_on_stderr, paint_err, Colours, Style},
};

/// What Zenoh logs as an error, its calls return too; RUST_LOG=zenoh=error shows it.
const DEFAULT_FILTER: &str = "warn,zenoh=off";
const EXAMPLE: &str = "\
Examples, without any robot: `rect sim` in one terminal, and in another
  rect peers                               # which robots are there
  rect sub '*/**'                          # everything that they publish
  rect topic list                          # which topics there are
  rect request wombat-2 battery            # asks a service of a robot

At a robot whose router runs (`sudo rect init wombat-1 --start` makes its configuration and starts it):
  rect pub arm/angle 12.5                  # publishes to every robot
  rect sub '*/arm/*'                       # shows what any robot publishes about its arm
  rect send wombat-2 grab '{\"force\": 3}'   # sends to one robot alone
  rect stream watch wombat-2 camera        # shows its pictures, as fresh as the link allows
  rect transfer send wombat-2 map.bin      # sends a file of any size
  rect connect base tcp 10.0.0.2 --port 7447  # adds a named connection
  rect bench wombat-2                      # measures the link to it (`rect bench --serve` there)
  rect doctor                              # finds what is wrong, and says what to do";

/// The Robot Extensible Communication Toolkit: robots that talk over Bluetooth LE, TCP and UDP.
#[derive(Parser)]
#[command(name = "rect", version, after_help = EXAMPLE)]
struct Arguments {
    /// When output is coloured; on a terminal unless NO_COLOR is set
    #[arg(long, global = true, value_enum, value_name = "WHEN", default_value_t = When::Auto)]
    color: When,
    #[command(subcommand)]
    command: Command,
}

/// When output is coloured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum When {
    Auto,
    Always,
    Never,
}

#[derive(Subcommand)]
enum Command {
    Sim(router::SimArguments),
    Pub(speak::PubArguments),
    Send(speak::SendArguments),
    Sub(listen::SubArguments),
    Request(ask::RequestArguments),
    Serve(ask::ServeArguments),
    Stream(stream::StreamArguments),
    Topic(topic::TopicArguments),
    Transfer(transfer::TransferArguments),
    Peers(registry::PeersArguments),
    Status(router::StatusArguments),
    Connections(registry::ConnectionsArguments),
    Connect(configure::ConnectArguments),
    Disconnect(configure::DisconnectArguments),
    Scan(router::ScanArguments),
    Bench(bench::BenchArguments),
    Doctor(router::DoctorArguments),
    Init(router::InitArguments),
    Check(router::CheckArguments),
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
    choose_colours(match arguments.color {
        When::Auto => Colours::Auto,
        When::Always => Colours::Always,
        When::Never => Colours::Never,
    });
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_env("RUST_LOG")
                .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(DEFAULT_FILTER)),
        )
        .with_writer(std::io::stderr)
        .with_ansi(colours_on_stderr())
        // It would report them by a macro that panics once stderr is closed.
        .log_internal_errors(false)
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
        Command::Topic(arguments) => wait(topic::run(arguments)),
        Command::Transfer(arguments) => wait(transfer::run(arguments)),
        Command::Peers(arguments) => wait(registry::peers(arguments)),
        Command::Connections(arguments) => wait(registry::connections(arguments)),
        Command::Connect(arguments) => wait(configure::connect(arguments)),
        Command::Disconnect(arguments) => wait(configure::disconnect(arguments)),
        Command::Bench(arguments) => wait(bench::run(arguments)),
        Command::Sim(arguments) => router::sim(arguments),
        Command::Status(arguments) => router::status(arguments),
        Command::Scan(arguments) => router::scan(arguments),
        Command::Doctor(arguments) => router::doctor(arguments),
        Command::Init(arguments) => router::init(arguments),
        Command::Check(arguments) => router::check(arguments),
    };
    match done {
        Ok(status) => status,
        Err(error) => {
            report(error.as_ref());
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

/// Prints an error, parts of which may come from another robot.
fn report(error: &(dyn std::error::Error + 'static)) {
    rect::errln!(
        "{} {}",
        paint_err(Style::Wrong, "rect:"),
        paragraph(&error.to_string())
    );
}

/// The endpoint of a router on the command line.
fn endpoint(text: &str) -> Result<String, rect::core::endpoint::EndpointError> {
    rect::core::endpoint::parse(text)
}
