//! `rect-router`: a router that accepts zenohd's flags and configuration files and adds Bluetooth LE links.
//!
//! This file only defines the order of the steps. The flags become a configuration (`config.rs`), the configuration becomes
//! a running router (`router.rs`) with its threads (`threads.rs`) and memory (`memory.rs`), and a signal stops it
//! (`signals.rs`). Before all that, the router registers its links (`links.rs`) and gives up its privileges (`privileges.rs`). An error is reported once, on stderr.

use std::process::ExitCode;

use rect_core::text::humanize;
use rect_router::{
    args, commands,
    config::{self, SessionSettings},
    limits::SessionLimits,
    links, logging, memory, privileges,
    robot_services::RobotServices,
    router, threads, version,
};

fn main() -> ExitCode {
    threads::set();
    memory::limit_arenas();
    links::register();
    let args = args::parse();
    if let Some(command) = &args.command {
        return commands::run(command);
    }
    let status = match privileges::use_and_drop()
        .map_err(Into::into)
        .and_then(|()| run(&args))
    {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            logging::report(&humanize::with_causes(error.as_ref()));
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
        .map(|settings| RobotServices::prepare(settings, &mut config))
        .transpose()?;
    tracing::debug!("Initial conf: {}", config::without_secrets(&config));
    let limits = SessionLimits::of(&config, &sessions)?;
    router::run(config, limits, robot)?;
    Ok(())
}
