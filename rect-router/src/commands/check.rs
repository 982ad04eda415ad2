//! Implements `rect-router check`: reads a configuration as the router would, and checks that this computer can run it.
use std::path::Path;

use clap::Parser;

use super::{service, Failure};
use crate::{
    args::{Args, CheckArgs},
    config,
    limits::SessionLimits,
    robot_services::RobotServices,
};

/// Checks the configuration, the login file, the connections file and the listeners without starting anything.
///
/// # Errors
/// The first invalid setting or file, or else all listeners that cannot start.
pub fn run(args: &CheckArgs) -> Result<(), Failure> {
    let flags = Args::try_parse_from(["rect-router", "--config", &args.config])?;
    let (mut config, settings) = config::from_args(&flags)?;
    let sessions = settings
        .as_ref()
        .map_or_else(Default::default, |settings| settings.sessions.clone());
    if let Some(settings) = settings {
        RobotServices::prepare(settings, &mut config)?.check()?;
    }
    SessionLimits::of(&config, &sessions)?;
    let is_service = is_of_service(Path::new(&args.config));
    let is_created_at_start =
        |folder: &Path| is_service && folder == Path::new(service::RUNTIME_FOLDER);
    let problems: Vec<_> = (config::listener_problems(&config, is_created_at_start).iter())
        .map(ToString::to_string)
        .collect();
    if !problems.is_empty() {
        return Err(format!("{}: {}", args.config, problems.join("; ")).into());
    }
    // The router starts in spite of these.
    let exposed = config::exposed_login_file(&config);
    let exposed = exposed.map(|exposed| format!("{exposed}; run: {}", exposed.remedy()));
    let missing = config::missing_adapters(&config, Path::new("/"));
    let missing = missing.iter().map(ToString::to_string);
    let warnings: Vec<_> = exposed.into_iter().chain(missing).collect();
    for warning in &warnings {
        rect_terminal::outln!("{}: warning: {warning}", args.config);
    }
    let otherwise = if warnings.is_empty() {
        ""
    } else {
        " otherwise"
    };
    rect_terminal::outln!("{}: no problems found{otherwise}", args.config);
    Ok(())
}

/// Returns whether the installed service uses this configuration.
fn is_of_service(config: &Path) -> bool {
    let folder = std::path::absolute(config).ok();
    let folder = folder.as_deref().and_then(Path::parent);
    folder.is_some_and(service::is_installed_for)
}
