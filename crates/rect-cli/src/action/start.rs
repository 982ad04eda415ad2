//! Implements `rect action start`.
use std::{pin::pin, process::ExitCode};

use clap::Args;
use rect::{ActionRun, Error, Name, StartOptions};
use rect_core::action;
use rect_terminal as terminal;
use serde_json::json;

use super::{
    action_name,
    follow::{self, Interrupts, INTERRUPTED},
    goal_id,
};
use crate::{
    payload::PayloadArguments,
    runtime,
    session::{name, JoinArguments},
    Done, Failure,
};

/// Start a goal of an action, and follow it to its end
///
/// Shows a bar on a terminal, with what the program reports. Ctrl-C cancels the goal and waits for its end; press it again to leave at
/// once. The result is printed at the end.
///
/// Most actions cancel a goal when the robot that has started it cannot be reached for 5 s: that is the robot of this command.
#[derive(Args)]
#[command(after_help = "\
Examples:
  rect action start wombat-2 dig 3
  rect action start wombat-2 drive_to '{\"x\": 1, \"y\": 2}'
  rect action start wombat-2 dig 3 --id hole-7     # started twice with the same id, it runs once
  rect action start wombat-2 dig 3 --detach        # only starts it, and prints its id
  rect action start wombat-2 dig 3 --json | jq .progress

Exit status: 0 if the goal is done (with --detach: if it was accepted), 1 if it has ended in another way, 130 if Ctrl-C has ended this
command before the end of the goal.")]
pub struct StartArguments {
    /// The robot
    #[arg(value_parser = name)]
    robot: Name,
    /// The action
    #[arg(value_parser = action_name)]
    action: String,
    #[command(flatten)]
    payload: PayloadArguments,
    /// The id of the goal [default: a random one]
    #[arg(long, value_name = "ID", value_parser = goal_id)]
    id: Option<String>,
    /// Exit as soon as the goal is accepted, which goes on; follow it with `rect action watch`
    #[arg(long)]
    detach: bool,
    /// Print JSON: a line for each change, and one for the end
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect action start`.
pub fn run(arguments: StartArguments) -> Done {
    rect::use_one_thread();
    let runtime = runtime()?;
    let done = runtime.block_on(start(arguments));
    runtime.shutdown_background();
    done
}

async fn start(arguments: StartArguments) -> Done {
    // Before the goal is started, so that no signal ends this program without a cancel.
    let mut interrupts = Interrupts::new()?;
    let goal = arguments.payload.payload()?;
    let own = tokio::select! {
        joined = arguments.join.join_unnamed() => joined?,
        () = interrupts.next() => return Ok(ExitCode::from(INTERRUPTED)),
    };
    let StartArguments { robot, action, .. } = &arguments;
    let random_id = || action::goal_id(rand::random());
    let id = arguments.id.clone().unwrap_or_else(random_id);
    let mut is_cancelled = false;
    let mut starting = pin!(own.start_with(robot, action, goal, StartOptions::new().id(&id)));
    let run = loop {
        tokio::select! {
            run = &mut starting => break run.map_err(|error| unknown(error, &arguments, &id))?,
            () = interrupts.next() => {
                // The goal may have begun.
                if is_cancelled || arguments.detach {
                    return Ok(ExitCode::from(INTERRUPTED));
                }
                is_cancelled = true;
            }
        }
    };
    if !arguments.detach {
        return follow::to_end(&run, arguments.json, Some(&mut interrupts), is_cancelled).await;
    }
    accepted(&run, arguments.json)
}

/// Prints that a goal is accepted, or fails if it was refused.
fn accepted(run: &ActionRun, as_json: bool) -> Done {
    let is_refused = run.phase().is_end();
    if as_json {
        let (phase, reason) = (run.phase(), run.reason());
        terminal::json_line(&json!({
            "robot": run.robot(), "action": run.action(), "id": run.id(), "phase": phase, "reason": reason,
        }))?;
    } else if is_refused {
        let (phase, reason) = (run.phase(), run.reason());
        return Err(Error::Goal { phase, reason }.into());
    } else {
        terminal::outln!("{}", run.id());
    }
    Ok(ExitCode::from(u8::from(is_refused)))
}

/// Adds to an error what can be done if it is not known whether the goal has begun.
fn unknown(error: Error, arguments: &StartArguments, id: &str) -> Failure {
    match error {
        Error::TimedOut { .. } | Error::Interrupted { .. } => format!(
            "{error}. The goal may have begun: start it again with `--id {id}`, which runs it once, or cancel it with `rect action cancel {} {} {id}`",
            arguments.robot, arguments.action
        )
        .into(),
        error => error.into(),
    }
}
