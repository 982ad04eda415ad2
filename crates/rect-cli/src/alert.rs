//! Implements `rect alert`, which shows, raises and clears alerts.
use std::process::ExitCode;

use clap::{Args, Subcommand};
use rect::{Level, RobotAlert};
use rect_core::text::humanize::duration;
use rect_terminal::{self as terminal, Cell, Style, Table};
use serde_json::json;

use crate::{
    session::{JoinArguments, ListArguments},
    Done, Failure,
};

const EXAMPLE: &str = "\
Examples:
  rect alert list                                  # all robots
  rect alert raise 'battery low' --level warn      # as this robot; until somebody clears it
  rect alert clear 'battery low'";

/// Show, raise and clear alerts: what is wrong with robots
#[derive(Args)]
#[command(after_help = EXAMPLE)]
pub struct AlertArguments {
    #[command(subcommand)]
    command: AlertCommand,
}

#[derive(Subcommand)]
enum AlertCommand {
    /// List the alerts of a robot, or of all robots of the fleet
    List(ListArguments),
    /// Raise an alert of this robot, or replace it
    Raise(RaiseArguments),
    /// Clear an alert of this robot
    Clear(ClearArguments),
}

#[derive(Args)]
struct RaiseArguments {
    /// The problem, for people
    text: String,
    /// debug, info, warn or error
    #[arg(long, default_value = "warn")]
    level: Level,
    /// Its name, if the text changes [default: the text]
    #[arg(long)]
    name: Option<String>,
    #[command(flatten)]
    join: JoinArguments,
}

#[derive(Args)]
struct ClearArguments {
    /// Its name or text
    name: String,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect alert`.
pub async fn run(arguments: AlertArguments) -> Done {
    match arguments.command {
        AlertCommand::List(arguments) => list(arguments).await?,
        AlertCommand::Raise(RaiseArguments {
            text,
            level,
            name,
            join,
        }) => {
            let robot = join.join().await?;
            let name = name.as_deref().unwrap_or(&text);
            robot.alert_named(name, level, &text).await?;
            robot.close().await?;
        }
        AlertCommand::Clear(ClearArguments { name, join }) => {
            let robot = join.join().await?;
            robot.clear_alert(&name).await?;
            robot.close().await?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

async fn list(arguments: ListArguments) -> Result<(), Failure> {
    let own = arguments.join.join_unnamed().await?;
    let alerts = own.alerts(arguments.robot).await?;
    own.close().await?;
    if arguments.json {
        let documents: Vec<_> = alerts.iter().map(document).collect();
        terminal::json(&documents)?;
    } else if alerts.is_empty() {
        terminal::outln!("no alerts");
    } else {
        table(&alerts).print();
    }
    Ok(())
}

fn document(one: &RobotAlert) -> serde_json::Value {
    let mut document = one.to_json();
    document["robot"] = json!(one.robot);
    document
}

/// Returns the alerts as a table.
pub fn table(alerts: &[RobotAlert]) -> Table {
    let mut table = Table::new(&["ROBOT", "LEVEL", "?ALERT", "SINCE", "?PROGRAM"]);
    for one in alerts {
        let style = Style::of_level(one.alert.level).unwrap_or(Style::Faint);
        let program = match one.retained.has_ended {
            true if one.alert.program.is_empty() => "its program has ended".to_owned(),
            true => format!("{}, which has ended", one.alert.program),
            false => one.alert.program.clone(),
        };
        table.row(vec![
            Cell::styled(Style::Name, one.robot.as_str()),
            Cell::styled(style, one.alert.level.as_str()),
            one.alert.text.as_str().into(),
            duration(one.retained.age).into(),
            program.into(),
        ]);
    }
    table
}
