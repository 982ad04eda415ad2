//! Implements `rect param list` and `rect param get`.
use std::{collections::BTreeMap, process::ExitCode};

use clap::Args;
use rect::{Error, Name, Parameter, ParameterValue, Robot};
use rect_core::parameters::declaration::Kind;
use rect_terminal::{self as terminal, Cell, Style, Table};
use serde_json::{json, Map, Value as Json};

use super::{
    groups::{self, Group},
    place::{GroupPlace, Place},
};
use crate::{
    retained::age,
    session::{name, JoinArguments},
    Done, Failure,
};

/// Follows a value that is not the default.
const CHANGED: &str = " *";

/// List the parameters of a robot, or of all robots of the fleet
///
/// Also lists the last values of programs that have ended, if a router keeps them.
#[derive(Args)]
#[command(after_help = "Example: rect param list wombat-2")]
pub struct ListArguments {
    /// The robot [default: all]
    #[arg(value_parser = name)]
    robot: Option<Name>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Print the value of a parameter as a line of JSON, or all parameters of a group as a table
///
/// The exit status is 1 if no value is known.
#[derive(Args)]
#[command(after_help = "\
Examples:
  rect param get wombat-2/drive/kp         # prints 2.0
  rect param get wombat-2/drive            # prints a table")]
pub struct GetArguments {
    /// The parameter, <robot>/<group>/<name>, or the group, <robot>/<group>
    #[arg(value_name = "ROBOT/GROUP[/NAME]")]
    place: Place,
    /// Print JSON; always for one parameter
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect param list`.
pub async fn list(arguments: ListArguments) -> Done {
    let own = arguments.join.join_unnamed().await?;
    let mut answers = match &arguments.robot {
        Some(robot) => groups::of_robots(&own, vec![robot.clone()]).await,
        None => groups::of_fleet(&own).await?,
    };
    groups::add_ended(&own, arguments.robot.as_ref(), &mut answers).await;
    let mut found = Vec::new();
    for (robot, answer) in answers {
        match answer {
            Ok(groups) => found.push((robot, groups)),
            Err(error) if arguments.robot.is_some() => return Err(error.into()),
            Err(error) => rect_terminal::errln!("rect: {robot}: {error}"),
        }
    }
    if arguments.json {
        let robots = found.iter().map(|(robot, groups)| {
            let groups = groups
                .iter()
                .map(|group| (group.name.clone(), as_json(group)));
            (robot.to_string(), Json::from(groups.collect::<Map<_, _>>()))
        });
        terminal::json(&robots.collect::<Map<_, _>>())?;
    } else {
        print(
            found
                .iter()
                .flat_map(|(robot, groups)| groups.iter().map(move |group| (robot, group))),
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// Runs `rect param get`.
pub async fn get(arguments: GetArguments) -> Done {
    let own = arguments.join.join_unnamed().await?;
    let Place { group: place, name } = arguments.place;
    let Some(name) = name else {
        let group = group(&own, &place).await?;
        if arguments.json {
            terminal::json(&as_json(&group))?;
        } else {
            print([(&place.robot, &group)]);
            if let Some(latest) = &group.latest {
                if !latest.snapshot.changed.is_empty() {
                    let names = latest.snapshot.changed.join(", ");
                    let by = match latest.snapshot.by.as_str() {
                        "" => "the program itself",
                        by => by,
                    };
                    let text = format!("last change: {names}, by {by}");
                    rect_terminal::outln!("{}", rect_core::text::display::line(&text));
                }
            }
        }
        return Ok(ExitCode::SUCCESS);
    };
    // The catalogue is only needed if there is no such value.
    let latest = groups::latest(&own, &place.robot, &place.group).await?;
    let found = latest
        .as_ref()
        .and_then(|latest| latest.snapshot.values.get(&name));
    let Some(value) = found else {
        let group = group(&own, &place).await?;
        let reason = match &group.declaration {
            Some(declaration) => declaration.find(&name).err(),
            None => Some(format!(
                "it had no parameter {name:?} when its program ended"
            )),
        };
        let reason = reason.unwrap_or_else(|| format!("the value of {name} is not known yet"));
        return Err(format!("{place}: {reason}").into());
    };
    terminal::json_line(value)?;
    let retained = latest.as_ref().and_then(|latest| latest.retained.as_ref());
    if let Some(ended) = retained.filter(|retained| retained.has_ended) {
        rect_terminal::errln!(
            "rect: {place}: its program has ended; this is its last value, {}",
            age(ended)
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns a group, also if its program has ended.
async fn group(own: &Robot, place: &GroupPlace) -> Result<Group, Failure> {
    let mut answers = groups::of_robots(own, vec![place.robot.clone()]).await;
    groups::add_ended(own, Some(&place.robot), &mut answers).await;
    let Some((robot, answer)) = answers.pop() else {
        return Err(Error::Closed.into());
    };
    let mut groups = answer?;
    match groups.iter().position(|group| group.name == place.group) {
        Some(at) => Ok(groups.swap_remove(at)),
        None => Err(Error::NoParameters {
            group: place.group.clone(),
            available: groups.into_iter().map(|group| group.name).collect(),
            robot,
        }
        .into()),
    }
}

fn print<'a>(groups: impl IntoIterator<Item = (&'a Name, &'a Group)>) {
    let mut table = Table::new(&["PARAMETER", "VALUE", "DEFAULT", "?RANGE", "?UNIT", "?ABOUT"]);
    let mut has_changed = false;
    for (robot, group) in groups {
        let place =
            |name: &str| Cell::styled(Style::Name, format!("{robot}/{}/{name}", group.name));
        for parameter in group.parameters() {
            let value = group.value(parameter);
            let is_changed = value
                .as_ref()
                .is_some_and(|value| *value != parameter.default);
            has_changed |= is_changed;
            let value = match value {
                Some(value) if is_changed => {
                    Cell::styled(Style::Heading, format!("{value}{CHANGED}"))
                }
                Some(value) => value.to_string().into(),
                None => "".into(),
            };
            table.row(vec![
                place(&parameter.name),
                value,
                parameter.default.to_string().into(),
                range(parameter).into(),
                parameter.unit.as_str().into(),
                parameter.about.as_str().into(),
            ]);
        }
        if group.declaration.is_none() {
            let values = group
                .latest
                .iter()
                .flat_map(|latest| &latest.snapshot.values);
            for (name, value) in values {
                table.row(vec![place(name), value.to_string().into()]);
            }
        }
        if group.has_ended() {
            let latest = group.latest.as_ref();
            let since = latest.and_then(|latest| latest.retained.as_ref()).map(age);
            let since = since.map_or_else(String::new, |since| format!(", changed {since}"));
            table.note(&format!(
                "the program of {robot}/{} has ended: these are its last values{since}",
                group.name
            ));
        }
    }
    table.print();
    if has_changed {
        rect_terminal::outln!("{}: not the default", CHANGED.trim());
    }
}

/// Returns what a parameter accepts: `0 to 10`, `left, right`.
fn range(parameter: &Parameter) -> String {
    let kind = match parameter.kind {
        Kind::Bool => "true, false",
        Kind::Integer => "integer",
        Kind::Number => "",
        Kind::Text => "text",
        Kind::Choice => &parameter.choices.join(", "),
        Kind::Numbers => "list",
    };
    let limits = match (parameter.min, parameter.max) {
        (Some(min), Some(max)) => format!("{min} to {max}"),
        (Some(min), None) => format!("from {min}"),
        (None, Some(max)) => format!("to {max}"),
        (None, None) if kind.is_empty() => "number".to_owned(),
        (None, None) => String::new(),
    };
    let parts = [kind, &limits];
    let parts: Vec<_> = parts.into_iter().filter(|part| !part.is_empty()).collect();
    let access = if parameter.read_only {
        ", read-only"
    } else {
        ""
    };
    format!("{}{access}", parts.join(" "))
}

/// Returns a group as JSON: the declaration of each parameter with its value.
fn as_json(group: &Group) -> Json {
    let snapshot = group.latest.as_ref().map(|latest| &latest.snapshot);
    let parameters = match &group.declaration {
        Some(declaration) => {
            let parameters = declaration.parameters().iter();
            let parameters = parameters.map(|parameter| {
                let mut json = json!(parameter);
                json["value"] = group
                    .value(parameter)
                    .as_ref()
                    .map_or(Json::Null, Json::from);
                json
            });
            parameters.collect()
        }
        None => {
            let values: &BTreeMap<String, ParameterValue> = match snapshot {
                Some(snapshot) => &snapshot.values,
                None => &BTreeMap::new(),
            };
            let values = values.iter();
            values
                .map(|(name, value)| json!({"name": name, "value": value}))
                .collect::<Vec<_>>()
        }
    };
    json!({
        "program": group.program,
        "has_ended": group.has_ended(),
        "parameters": parameters,
        "changed": snapshot.map(|snapshot| &snapshot.changed),
        "by": snapshot.map(|snapshot| &snapshot.by),
    })
}
