//! Owns `rect-router check`: a configuration, read as the router reads it, and what this computer lacks for it.
use std::path::Path;

use clap::Parser;

use super::{service, CheckArgs, Failure};
use crate::{args::Args, config, limits::SessionLimits, robot::Robot};

/// Reads everything and starts nothing; the error names all that would not work.
pub fn run(args: &CheckArgs) -> Result<(), Failure> {
    let flags = Args::try_parse_from(["rect-router", "--config", &args.config])?;
    let (mut config, settings) = config::from_args(&flags)?;
    let sessions = settings
        .as_ref()
        .map_or_else(Default::default, |settings| settings.sessions.clone());
    if let Some(settings) = settings {
        Robot::prepare(settings, &mut config)?.check()?;
    }
    SessionLimits::of(&config, &sessions)?;
    let is_service = is_of_service(Path::new(&args.config));
    let is_made = |folder: &Path| is_service && folder == Path::new(service::RUNTIME);
    let wrong: Vec<_> = (config::unstartable(&config, is_made).iter())
        .map(ToString::to_string)
        .collect();
    if !wrong.is_empty() {
        return Err(format!("{}: {}", args.config, wrong.join("; ")).into());
    }
    match config::exposed_login_file(&config) {
        // The router starts all the same.
        Some(exposed) => {
            let remedy = exposed.remedy();
            rect::outln!("{}: warning: {exposed}; run: {remedy}", args.config);
        }
        None => rect::outln!("{}: nothing is wrong with it", args.config),
    }
    Ok(())
}

/// Whether the installed service runs with that configuration.
fn is_of_service(config: &Path) -> bool {
    let folder = std::path::absolute(config).ok();
    let folder = folder.as_deref().and_then(Path::parent);
    folder.is_some_and(service::is_installed_for)
}
