//! Owns `rect-router check`: a configuration, read as the router reads it.
use clap::Parser;

use super::{CheckArgs, Failure};
use crate::{args::Args, config, robot::Robot};

pub fn run(args: &CheckArgs) -> Result<(), Failure> {
    let flags = Args::try_parse_from(["rect-router", "--config", &args.config])?;
    let (mut config, settings) = config::from_args(&flags)?;
    if let Some(settings) = settings {
        Robot::prepare(settings, &mut config)?.check()?;
    }
    rect::outln!("{}: nothing is wrong with it", args.config);
    Ok(())
}
