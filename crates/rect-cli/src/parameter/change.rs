//! Implements `rect param set` and `rect param reset`, and explains why a change failed.
use std::{collections::BTreeMap, process::ExitCode};

use clap::Args;
use rect::{Error, ParameterOrder, ParameterValue, Robot};
use rect_terminal::{paint_err, Style};

use super::place::{Assignment, GroupPlace};
use crate::{
    session::{require_reachable, JoinArguments},
    Done, Failure,
};

/// The maximum length of a reason of a program, in characters.
const MAX_REASON: usize = 500;

/// Change parameters: all, or none if the program refuses one
///
/// The command ends when the values are in force and stored, so that they survive a power cut.
#[derive(Args)]
#[command(after_help = "\
Examples:
  rect param set wombat-2/drive kp=2.0 side=left
  rect param set wombat-2/drive 'name=\"7\"'   # a text that would be a number without quotation marks")]
pub struct SetArguments {
    /// The group, <robot>/<group>
    #[arg(value_name = "ROBOT/GROUP")]
    group: GroupPlace,
    /// The parameters and their values: JSON, or otherwise a text
    #[arg(value_name = "NAME=VALUE", required = true)]
    values: Vec<Assignment>,
    #[command(flatten)]
    change: ChangeArguments,
}

/// Give parameters of a group their defaults: all of the group, or some
///
/// Read-only parameters keep their values, because only their program changes them.
#[derive(Args)]
#[command(after_help = "\
Examples:
  rect param reset wombat-2/drive kp
  rect param reset wombat-2/drive          # all parameters of the group")]
pub struct ResetArguments {
    /// The group, <robot>/<group>
    #[arg(value_name = "ROBOT/GROUP")]
    group: GroupPlace,
    /// The parameters [default: all of the group]
    #[arg(value_name = "NAME")]
    names: Vec<String>,
    #[command(flatten)]
    change: ChangeArguments,
}

#[derive(Args)]
struct ChangeArguments {
    /// Do not wait until the values are stored, only until they are in force
    #[arg(long)]
    no_wait: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect param set`.
pub async fn set(arguments: SetArguments) -> Done {
    let mut values = BTreeMap::new();
    for Assignment { name, value } in arguments.values {
        if values.insert(name.clone(), value).is_some() {
            return Err(format!("{name} occurs twice").into());
        }
    }
    let order = ParameterOrder::from(values.clone());
    change(
        &arguments.group,
        order,
        &in_words(&values),
        &arguments.change,
    )
    .await
}

/// Runs `rect param reset`.
pub async fn reset(arguments: ResetArguments) -> Done {
    let (order, what) = match arguments.names.is_empty() {
        true => (ParameterOrder::reset_all(), "the defaults".to_owned()),
        false => {
            let what = format!("the defaults of {}", arguments.names.join(", "));
            (ParameterOrder::reset(arguments.names), what)
        }
    };
    change(&arguments.group, order, &what, &arguments.change).await
}

/// Changes a group, and prints which values are in force. `what` describes them if the program does not store them.
async fn change(
    place: &GroupPlace,
    order: ParameterOrder,
    what: &str,
    arguments: &ChangeArguments,
) -> Done {
    let own = arguments.join.join_unnamed().await?;
    let (order, state) = match arguments.no_wait {
        true => (order, "in force"),
        false => (order.stored(), "in force and stored"),
    };
    let changed = own.set_parameters(&place.robot, &place.group, order).await;
    match changed {
        Ok(values) => rect_terminal::outln!("{place}: {}: {state}", in_words(&values)),
        Err(Error::NotStored { reason, .. }) => {
            rect_terminal::outln!("{place}: {what}: in force");
            rect_terminal::errln!(
                "{} {place} is not stored, and lost when its program ends: {}",
                paint_err(Style::Poor, "rect: warning:"),
                rect_core::text::display::line(&reason)
            );
        }
        Err(error) => {
            let unchanged = match error {
                Error::Service { .. } => "; nothing has changed",
                _ => "",
            };
            let reason = reason(&own, place, error).await;
            return Err(Failure::from(format!("{place}: {reason}{unchanged}")));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns values in words: `kp = 2, side = "left"`.
pub fn in_words(values: &BTreeMap<String, ParameterValue>) -> String {
    let values = values
        .iter()
        .map(|(name, value)| format!("{name} = {value}"));
    values.collect::<Vec<_>>().join(", ")
}

/// Returns why a group could not be changed, as a program's user has to know it.
pub async fn reason(own: &Robot, place: &GroupPlace, error: Error) -> String {
    match error {
        Error::Service { payload, .. } => {
            let text = String::from_utf8_lossy(&payload.bytes);
            let text: String = text.chars().take(MAX_REASON).collect();
            format!("refused: {text}")
        }
        Error::NoParameters { .. } => match require_reachable(own, &place.robot).await {
            Ok(()) => error.to_string(),
            Err(error) => error.to_string(),
        },
        error => error.to_string(),
    }
}
