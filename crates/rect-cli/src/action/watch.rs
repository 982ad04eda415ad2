//! Implements `rect action watch`.
use clap::Args;
use rect::{Name, Robot};

use super::{action_name, follow, goal_id};
use crate::{
    session::{name, require_reachable, JoinArguments},
    Done, Failure,
};

/// Follow a goal of any program to its end
///
/// Ctrl-C ends this command, and not the goal.
#[derive(Args)]
#[command(after_help = "\
Examples:
  rect action watch wombat-2 dig                   # the newest goal
  rect action watch wombat-2 dig hole-7

Exit status: 0 if the goal is done, 1 if it has ended in another way, 130 if Ctrl-C has ended this command.")]
pub struct WatchArguments {
    /// The robot
    #[arg(value_parser = name)]
    robot: Name,
    /// The action
    #[arg(value_parser = action_name)]
    action: String,
    /// The id of the goal [default: the newest goal]
    #[arg(value_parser = goal_id)]
    goal: Option<String>,
    /// Print JSON: a line for each change, and one for the end
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect action watch`.
pub async fn run(arguments: WatchArguments) -> Done {
    let WatchArguments {
        robot,
        action,
        goal,
        json,
        join,
    } = arguments;
    let own = join.join_unnamed().await?;
    let goal = match goal {
        Some(goal) => goal,
        None => newest(&own, &robot, &action).await?,
    };
    let run = own.find(&robot, &action, &goal).await?;
    follow::to_end(&run, json, None, false).await
}

/// Returns the id of the newest goal of an action.
async fn newest(own: &Robot, robot: &Name, action: &str) -> Result<String, Failure> {
    let goals = own.goals(Some(robot)).await?;
    if let Some(newest) = goals.into_iter().find(|goal| goal.action == action) {
        return Ok(newest.id);
    }
    require_reachable(own, robot).await?;
    Err(format!(
        "{robot} knows no goal of {action}: goals are kept until ten minutes after their end; `rect action list {robot}` lists all"
    )
    .into())
}
