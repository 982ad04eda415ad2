//! Implements `rect param export`.
use std::{collections::BTreeMap, path::PathBuf, process::ExitCode};

use clap::Args;
use rect::Name;
use rect_core::storage::ReplacedFile;
use rect_terminal as terminal;

use super::{
    groups::{self, Group},
    profile::{Profile, Values},
};
use crate::{
    report,
    session::{name, JoinArguments},
    Done, Failure,
};

/// Write the parameters of robots as a profile, which `rect param import` sets again
///
/// A profile contains the values that are not the defaults. It is not written if a robot or a value is missing. Read-only parameters and
/// programs that have ended are left out.
#[derive(Args)]
#[command(after_help = "Example: rect param export wombat-1 wombat-2 --to practice.json")]
pub struct ExportArguments {
    /// The robots [default: all that are reachable]
    #[arg(value_name = "ROBOT", value_parser = name)]
    robots: Vec<Name>,
    /// The file to write [default: print the profile]
    #[arg(long, value_name = "FILE")]
    to: Option<PathBuf>,
    /// Write the values that are the defaults, too, so that the profile keeps them when a later version of a program has other defaults
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect param export`.
pub async fn run(arguments: ExportArguments) -> Done {
    let own = arguments.join.join_unnamed().await?;
    let mut robots = arguments.robots;
    robots.sort();
    robots.dedup();
    let answers = match robots.is_empty() {
        true => groups::of_fleet(&own).await?,
        false => groups::of_robots(&own, robots).await,
    };
    let (mut profile, mut missing) = (Profile::new(), 0);
    for (robot, answer) in answers {
        let groups = match answer {
            Ok(groups) => groups,
            Err(error) => {
                report(&error);
                missing += 1;
                continue;
            }
        };
        let mut values = BTreeMap::new();
        for group in groups.iter().filter(|group| !group.has_ended()) {
            match exported(group, arguments.all) {
                Some(exported) => {
                    values.insert(group.name.clone(), exported);
                }
                None => {
                    missing += 1;
                    rect_terminal::errln!("rect: {robot}/{}: its values are not known", group.name);
                }
            }
        }
        if !values.is_empty() {
            profile.insert(robot, values);
        }
    }
    if missing > 0 {
        return Err(
            "no profile is written, because it would be incomplete: name the robots to export"
                .into(),
        );
    }
    let (robots, groups) = (
        profile.len(),
        profile.values().map(BTreeMap::len).sum::<usize>(),
    );
    if groups == 0 {
        return Err("no profile is written: no program of these robots has parameters".into());
    }
    match arguments.to {
        None => terminal::json(&profile)?,
        Some(path) => {
            let text = serde_json::to_string_pretty(&profile)? + "\n";
            let written = ReplacedFile::new(&path).replace(text);
            written.map_err(|error| Failure::from(format!("{}: {error}", path.display())))?;
            rect_terminal::outln!(
                "{} has the parameters of {}, {}",
                path.display(),
                count(robots, "robot"),
                count(groups, "group")
            );
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns a number of things: `1 group`, `2 groups`.
fn count(count: usize, noun: &str) -> String {
    let end = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{end}")
}

/// Returns the values of a group that a profile contains; `None` if one is not known.
fn exported(group: &Group, all: bool) -> Option<Values> {
    let declared = group.parameters().iter();
    let mut values = Values::new();
    for parameter in declared.filter(|parameter| !parameter.read_only) {
        let value = group.value(parameter)?;
        if all || value != parameter.default {
            values.insert(parameter.name.clone(), value);
        }
    }
    Some(values)
}
