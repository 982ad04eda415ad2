//! The `rect` command of RECT, the Robot Extensible Communication Toolkit. This file parses the arguments, runs the
//! selected command, and sets the exit status. Each command has a separate module.
mod action;
mod air;
mod alert;
mod bench;
mod choice;
mod completion;
mod configure;
mod dashboard;
mod dictionary;
mod display;
mod duration;
mod foxglove;
mod keyboard;
mod log;
mod manual;
mod measure;
mod parameter;
mod payload;
mod program;
mod publish;
mod record;
mod recording;
mod registry;
mod replay;
mod request;
mod retained;
mod router;
mod run;
mod session;
mod stop;
mod stream;
mod subscribe;
mod survey;
mod topic;
mod transfer;

use std::{future::Future, process::ExitCode};

use clap::{Parser, Subcommand, ValueEnum};
use rect_core::text::display::paragraph;
use rect_terminal::{choose_colours, colours_on_stderr, paint_err, Colours, Style};

/// Zenoh's log is disabled, since Zenoh's calls also return their errors; `RUST_LOG=zenoh=error` enables it.
const DEFAULT_FILTER: &str = "warn,zenoh=off";
const EXAMPLE: &str = "\
Examples without a robot: run `rect sim` in one terminal, and in another
  rect peers                               # lists the reachable robots
  rect sub '*/**'                          # prints everything that they publish
  rect topic list                          # lists the topics and their rates
  rect service list                        # lists the services that robots offer
  rect request wombat-2 battery            # sends a request to a service

Examples on a robot with a router (`sudo rect init wombat-1 --start` configures and starts it):
  rect pub arm/angle 12.5                  # publishes to every robot
  rect pub mode auto --retained            # publishes a value that programs that start later receive, too
  rect sub '*/arm/*'                       # prints the messages of all robots on these topics
  rect send wombat-2 grab '{\"force\": 3}'   # sends to one robot only
  rect stream watch wombat-2/camera        # receives a stream of pictures
  rect action start wombat-2 dig 3         # starts a long task, shows how far it is, and cancels it with Ctrl-C
  rect param set wombat-2/drive kp=2.0     # changes a parameter of a program that runs
  rect stop                                # stops all robots until somebody releases the stop
  rect transfer send wombat-2 map.bin      # sends a file of any size
  rect record                              # records this robot's messages; `rect replay` plays them
  rect connect base tcp 10.0.0.2 --port 7447  # adds a named connection
  rect bench wombat-2                      # measures the link (run `rect bench --serve` on wombat-2)
  rect survey wombat-2                     # measures the radios, step by step, and writes a page with plots
  rect doctor                              # finds problems and suggests solutions";

/// The Robot Extensible Communication Toolkit: communication between robots over Bluetooth LE, TCP and UDP.
#[derive(Parser)]
#[command(name = "rect", version, after_help = EXAMPLE)]
struct Arguments {
    /// When to colour the output; `auto`: on a terminal, unless NO_COLOR is set
    #[arg(long, global = true, value_enum, value_name = "WHEN", default_value_t = When::Auto)]
    color: When,
    #[command(subcommand)]
    command: Command,
}

/// When to colour the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum When {
    Auto,
    Always,
    Never,
}

#[derive(Subcommand)]
enum Command {
    Sim(router::SimArguments),
    Wifi(router::WifiArguments),
    Pub(publish::PubArguments),
    Send(publish::SendArguments),
    Sub(subscribe::SubArguments),
    Request(request::RequestArguments),
    Serve(request::ServeArguments),
    Stream(stream::StreamArguments),
    Topic(topic::TopicArguments),
    Program(program::ProgramArguments),
    Service(program::ServiceArguments),
    Action(action::ActionArguments),
    Param(parameter::ParamArguments),
    Stop(stop::StopArguments),
    Run(run::RunArguments),
    Log(log::LogArguments),
    Alert(alert::AlertArguments),
    Transfer(transfer::TransferArguments),
    Record(record::RecordArguments),
    Replay(replay::ReplayArguments),
    Recording(recording::RecordingArguments),
    Dashboard(dashboard::DashboardArguments),
    Foxglove(foxglove::FoxgloveArguments),
    Peers(registry::PeersArguments),
    Status(router::StatusArguments),
    Connections(registry::ConnectionsArguments),
    Connect(configure::ConnectArguments),
    Disconnect(configure::DisconnectArguments),
    Scan(router::ScanArguments),
    Bench(bench::BenchArguments),
    Survey(survey::SurveyArguments),
    Doctor(router::DoctorArguments),
    Init(router::InitArguments),
    Check(router::CheckArguments),
    Dictionary(dictionary::DictionaryArguments),
    Air(air::AirArguments),
    Completion(completion::CompletionArguments),
    Man(manual::ManArguments),
}

/// The error of a command, whose text is printed.
type Failure = Box<dyn std::error::Error + Send + Sync>;
/// The result of a command.
type Done = Result<ExitCode, Failure>;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    rect_links::register();
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
        // The subscriber reports its own errors with a macro that panics if stderr is closed.
        .log_internal_errors(false)
        .init();
    let done = match arguments.command {
        Command::Air(arguments) => air::run(arguments)
            .map(|()| ExitCode::SUCCESS)
            .map_err(Failure::from),
        Command::Completion(arguments) => Ok(completion::run(&arguments)),
        Command::Man(arguments) => manual::run(&arguments),
        Command::Dictionary(arguments) => dictionary::run(arguments),
        Command::Pub(arguments) => wait(publish::publish(arguments)),
        Command::Send(arguments) => wait(publish::send(arguments)),
        Command::Sub(arguments) => wait_on_one_thread(subscribe::run(arguments)),
        Command::Request(arguments) => wait_on_one_thread(request::request(arguments)),
        Command::Serve(arguments) => wait(request::serve(arguments)),
        Command::Stream(arguments) => wait(stream::run(arguments)),
        Command::Topic(arguments) => wait_on_one_thread(topic::run(arguments)),
        Command::Program(arguments) => wait_on_one_thread(program::programs(arguments)),
        Command::Service(arguments) => wait_on_one_thread(program::services(arguments)),
        Command::Action(arguments) => action::run(arguments),
        Command::Param(arguments) => wait_on_one_thread(parameter::run(arguments)),
        Command::Stop(arguments) => wait_on_one_thread(stop::run(arguments)),
        Command::Run(arguments) => wait(run::run(arguments)),
        Command::Log(arguments) => wait_on_one_thread(log::run(arguments)),
        Command::Alert(arguments) => wait_on_one_thread(alert::run(arguments)),
        Command::Transfer(arguments) => wait(transfer::run(arguments)),
        Command::Record(arguments) => record::run(arguments),
        Command::Replay(arguments) => wait(replay::run(arguments)),
        Command::Recording(arguments) => recording::run(arguments),
        Command::Dashboard(arguments) => wait(dashboard::run(arguments)),
        Command::Foxglove(arguments) => wait(foxglove::run(arguments)),
        Command::Peers(arguments) => wait_on_one_thread(registry::peers(arguments)),
        Command::Connections(arguments) => wait_on_one_thread(registry::connections(arguments)),
        Command::Connect(arguments) => wait_on_one_thread(configure::connect(arguments)),
        Command::Disconnect(arguments) => wait_on_one_thread(configure::disconnect(arguments)),
        Command::Bench(arguments) => wait(bench::run(arguments)),
        Command::Survey(arguments) => wait(survey::run(arguments)),
        Command::Sim(arguments) => router::sim(arguments),
        Command::Wifi(arguments) => router::wifi(arguments),
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

/// Runs a command that answers no queries, for which one thread of Zenoh is enough.
fn wait_on_one_thread(command: impl Future<Output = Done>) -> Done {
    rect::use_one_thread();
    wait(command)
}

fn runtime() -> std::io::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
}

/// Runs a command until it ends or Ctrl-C interrupts it.
fn wait(command: impl Future<Output = Done>) -> Done {
    let runtime = runtime()?;
    let done = runtime.block_on(async {
        tokio::select! {
            done = command => done,
            interrupted = tokio::signal::ctrl_c() => {
                interrupted?;
                // The status that shells use for an interrupted program.
                Ok(ExitCode::from(130))
            }
        }
    });
    runtime.shutdown_background();
    done
}

/// Prints an error. Control characters are replaced, since the text may come from another robot.
fn report(error: &(dyn std::error::Error + 'static)) {
    rect_terminal::errln!(
        "{} {}",
        paint_err(Style::Wrong, "rect:"),
        paragraph(&error.to_string())
    );
}

/// Parses the endpoint of a router on the command line.
fn endpoint(text: &str) -> Result<String, rect_core::session::endpoint::EndpointError> {
    rect_core::session::endpoint::parse(text)
}
