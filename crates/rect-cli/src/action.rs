//! Implements `rect action`, which lists, starts, follows and cancels the goals of actions: long tasks of programs, such as driving to a
//! place. The programs carry them out, and their robots' routers keep how far each goal has come.
mod cancel;
mod follow;
mod list;
mod start;
mod watch;

use clap::{Args, Subcommand};
use rect_core::name::parameter::is_name;

use crate::{wait_on_one_thread, Done};

/// Start, follow and cancel long tasks of programs, such as driving to a place
///
/// A program declares an action, such as `dig`. Each start of it is a goal, which has an id and one end: done, refused, failed,
/// cancelled, preempted by a newer goal, or lost because the program has ended. The robot's router keeps the state of a goal until ten
/// minutes after its end, so that everybody can follow it, also after a cut.
#[derive(Args)]
#[command(after_help = "\
Examples:
  rect action list                         # what the robots can do, and the goals that run
  rect action start wombat-2 dig 3         # starts `dig` with the value 3, and shows how far it is; Ctrl-C cancels it
  rect action watch wombat-2 dig           # follows the newest goal, which may be another program's")]
pub struct ActionArguments {
    #[command(subcommand)]
    command: ActionCommand,
}

#[derive(Subcommand)]
enum ActionCommand {
    List(list::ListArguments),
    Start(start::StartArguments),
    Watch(watch::WatchArguments),
    Cancel(cancel::CancelArguments),
}

/// Runs `rect action`.
pub fn run(arguments: ActionArguments) -> Done {
    match arguments.command {
        ActionCommand::List(arguments) => wait_on_one_thread(list::run(arguments)),
        ActionCommand::Start(arguments) => start::run(arguments),
        ActionCommand::Watch(arguments) => wait_on_one_thread(watch::run(arguments)),
        ActionCommand::Cancel(arguments) => wait_on_one_thread(cancel::run(arguments)),
    }
}

/// Parses the name of an action.
fn action_name(text: &str) -> Result<String, String> {
    match is_name(text) {
        true => Ok(text.to_owned()),
        false => Err(rect_core::action::wrong_action(text)),
    }
}

/// Parses the id of a goal.
fn goal_id(text: &str) -> Result<String, String> {
    match is_name(text) {
        true => Ok(text.to_owned()),
        false => Err(
            "the id of a goal has 1 to 40 letters, digits, `_`, `-` and `.`: `rect action list` shows the ids"
                .to_owned(),
        ),
    }
}
