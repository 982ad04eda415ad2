//! `rect-router`: a router that takes zenohd's flags and configuration files and speaks Bluetooth LE.
//!
//! Here is the order of things only: flags become a configuration (`config.rs`), the configuration a running router
//! (`router.rs`) with its threads (`threads.rs`), and a signal the end of it (`signals.rs`). Whatever is wrong is said
//! once, on stderr.

use std::process::ExitCode;

use rect::core::wording;
use rect_router::{
    args, commands, config,
    limits::{SessionLimits, SessionSettings},
    logging,
    robot::Robot,
    router, threads, version,
};

fn main() -> ExitCode {
    threads::set();
    let args = args::parse();
    if let Some(command) = &args.command {
        return commands::run(command);
    }
    let status = match run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            logging::report(&wording::with_causes(error.as_ref()));
            ExitCode::FAILURE
        }
    };
    logging::finish();
    status
}

fn run(args: &args::Args) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    logging::start()?;
    tracing::info!("rect-router {}", version::long());
    let (mut config, settings) = config::from_args(args)?;
    let sessions = settings
        .as_ref()
        .map_or_else(SessionSettings::default, |settings| {
            settings.sessions.clone()
        });
    let robot = settings
        .map(|settings| Robot::prepare(settings, &mut config))
        .transpose()?;
    tracing::debug!("Initial conf: {}", config::without_secrets(&config));
    let limits = SessionLimits::of(&config, &sessions)?;
    router::run(config, limits, robot)?;
    Ok(())
}
