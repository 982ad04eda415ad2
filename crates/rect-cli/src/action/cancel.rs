//! Implements `rect action cancel`.
use std::process::ExitCode;

use clap::Args;
use rect::{Error, Name};
use rect_terminal as terminal;

use super::{action_name, goal_id};
use crate::{
    session::{name, JoinArguments},
    Done,
};

/// Ask the program that carries out a goal to end it
///
/// Returns when the program has the wish; the end follows as soon as it heeds it, and `rect action watch` waits for that.
#[derive(Args)]
#[command(after_help = "\
Example: rect action cancel wombat-2 dig hole-7   # `rect action list` shows the ids

Exit status: 0 if the program has the wish, 1 if the goal had ended before, or the robot did not answer.")]
pub struct CancelArguments {
    /// The robot
    #[arg(value_parser = name)]
    robot: Name,
    /// The action
    #[arg(value_parser = action_name)]
    action: String,
    /// The id of the goal
    #[arg(value_parser = goal_id)]
    goal: String,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect action cancel`.
pub async fn run(arguments: CancelArguments) -> Done {
    let CancelArguments {
        robot,
        action,
        goal,
        join,
    } = arguments;
    let place = format!("{robot}/{action}/{goal}");
    let own = join.join_unnamed().await?;
    let run = own.find(&robot, &action, &goal).await?;
    let phase = run.phase();
    if phase.is_end() {
        return Err(format!("{place} has ended already: {phase}").into());
    }
    run.cancel().await.map_err(|error| match error {
        Error::Service { payload, .. } => {
            let text = String::from_utf8_lossy(&payload.bytes);
            format!("{place}: {text}")
        }
        error => error.to_string(),
    })?;
    terminal::outln!("{place} is asked to end");
    Ok(ExitCode::SUCCESS)
}
