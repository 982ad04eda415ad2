//! Implements `rect param import`.
use std::{collections::BTreeMap, path::PathBuf, process::ExitCode, sync::Arc};

use clap::Args;
use rect::{Error, Name, ParameterOrder, ParameterValue, Robot};
use rect_core::parameters::{self, order::Order};
use rect_terminal::{paint, Style};
use tokio::sync::{
    mpsc::{self, UnboundedSender},
    Semaphore,
};

use super::{
    change,
    groups::{self, Group},
    place::GroupPlace,
    profile::{self, Values},
};
use crate::{
    session::{name, JoinArguments},
    Done,
};

/// Number of groups of a robot that are set at the same time.
const MAX_CONCURRENT: usize = 16;

/// Set the parameters of a profile, which `rect param export` has written
///
/// Each group that the profile names gets its values as a whole: parameters that it does not name get their defaults, and if the program
/// refuses a value, the group keeps what it has. A robot that is not reachable does not delay the others. The exit status is 1 if a group
/// was not set.
#[derive(Args)]
#[command(after_help = "\
Examples:
  rect param import practice.json --dry-run  # shows what would change
  rect param import practice.json")]
pub struct ImportArguments {
    /// The profile
    file: PathBuf,
    /// Set only the parameters of this robot; can be repeated
    #[arg(long = "robot", value_name = "ROBOT", value_parser = name)]
    robots: Vec<Name>,
    /// Leave the parameters unchanged that the profile does not name
    #[arg(long)]
    keep: bool,
    /// Show what would change, and change nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// A group, and the values that it gets.
struct Part {
    place: GroupPlace,
    values: Values,
    keep: bool,
    dry_run: bool,
}

/// The outcome for a group.
enum Outcome {
    /// The changes, or those that would be made, in words.
    Set(String),
    /// The changes in words, and why they are not stored.
    NotStored(String, String),
    Unchanged,
    NotReachable,
    Failed(String),
}

type Outcomes = UnboundedSender<(GroupPlace, Outcome)>;

/// Runs `rect param import`.
pub async fn run(arguments: ImportArguments) -> Done {
    let mut profile = profile::read(&arguments.file)?;
    for robot in &arguments.robots {
        if !profile.contains_key(robot) {
            let robots: Vec<_> = profile.keys().map(Name::as_str).collect();
            let (file, robots) = (arguments.file.display(), robots.join(", "));
            return Err(
                format!("{file} has no parameters of {robot}; its robots: {robots}").into(),
            );
        }
    }
    profile.retain(|robot, _| arguments.robots.is_empty() || arguments.robots.contains(robot));
    let own = arguments.join.join_unnamed().await?;
    let reachable = own.peers().await?;
    let (outcomes, mut finished) = mpsc::unbounded_channel();
    for (robot, groups) in profile {
        let parts = groups.into_iter().map(|(group, values)| Part {
            place: GroupPlace {
                robot: robot.clone(),
                group,
            },
            values,
            keep: arguments.keep,
            dry_run: arguments.dry_run,
        });
        let parts = parts.collect();
        let is_reachable = robot == *own.name() || reachable.contains(&robot);
        let (own, outcomes) = (own.clone(), outcomes.clone());
        tokio::spawn(async move { set_all(&own, robot, parts, is_reachable, &outcomes).await });
    }
    drop(outcomes);
    let (mut total, mut set, mut unchanged) = (0, 0, 0);
    while let Some((place, outcome)) = finished.recv().await {
        total += 1;
        match &outcome {
            Outcome::Set(_) | Outcome::NotStored(..) => set += 1,
            Outcome::Unchanged => unchanged += 1,
            Outcome::NotReachable | Outcome::Failed(_) => {}
        }
        rect_terminal::outln!("{place}: {}", outcome.in_words(arguments.dry_run));
    }
    let (set_or_would, fail) = match arguments.dry_run {
        true => ("would be set", "would fail"),
        false => ("set", "failed"),
    };
    let mut sentence = format!("{set} of {total} groups {set_or_would}");
    if unchanged > 0 {
        sentence += &format!(", {unchanged} unchanged");
    }
    let failed = total - set - unchanged;
    if failed > 0 {
        return Err(format!("{sentence}, {failed} {fail}").into());
    }
    rect_terminal::outln!("{sentence}");
    Ok(ExitCode::SUCCESS)
}

impl Outcome {
    /// Returns the outcome as the rest of a line. Text of the program has its control characters replaced.
    fn in_words(&self, dry_run: bool) -> String {
        let (style, word, rest) = match self {
            Self::Set(changes) if dry_run => (Style::Good, "would be set", changes.clone()),
            Self::Set(changes) => (Style::Good, "set", changes.clone()),
            Self::NotStored(changes, reason) => {
                let rest =
                    format!("{changes}; not stored, and lost when its program ends: {reason}");
                (Style::Poor, "set", rest)
            }
            Self::Unchanged => (Style::Faint, "unchanged", String::new()),
            Self::NotReachable => (Style::Wrong, "not reachable", String::new()),
            Self::Failed(reason) => match reason.strip_prefix("refused: ") {
                Some(reason) => (Style::Wrong, "refused", reason.to_owned()),
                None => (Style::Wrong, "failed", reason.clone()),
            },
        };
        let rest = rect_core::text::display::line(&rest).into_owned();
        match rest.as_str() {
            "" => paint(style, word),
            rest => format!("{}: {rest}", paint(style, word)),
        }
    }
}

/// Sets the groups of a robot at the same time.
async fn set_all(
    own: &Robot,
    robot: Name,
    parts: Vec<Part>,
    is_reachable: bool,
    outcomes: &Outcomes,
) {
    let groups = match is_reachable {
        false => Err(Outcome::NotReachable),
        true => {
            let mut answers = groups::of_robots(own, vec![robot]).await;
            let groups = answers
                .pop()
                .map_or(Err(Error::Closed), |(_, groups)| groups);
            groups.map_err(|error| Outcome::Failed(error.to_string()))
        }
    };
    let mut groups: BTreeMap<_, _> = match groups {
        Ok(groups) => groups
            .into_iter()
            .map(|group| (group.name.clone(), group))
            .collect(),
        Err(outcome) => {
            for part in parts {
                let _ = outcomes.send((part.place, outcome.again()));
            }
            return;
        }
    };
    let places = Arc::new(Semaphore::new(MAX_CONCURRENT));
    for part in parts {
        // The semaphore is never closed.
        let place = places.clone().acquire_owned().await;
        let group = groups.remove(&part.place.group);
        let (own, outcomes) = (own.clone(), outcomes.clone());
        tokio::spawn(async move {
            let outcome = part.set(&own, group).await;
            drop(place);
            // It fails if the command ends.
            let _ = outcomes.send((part.place, outcome));
        });
    }
}

impl Outcome {
    /// Returns the outcome of a robot for another one of its groups.
    fn again(&self) -> Self {
        match self {
            Self::Failed(reason) => Self::Failed(reason.clone()),
            _ => Self::NotReachable,
        }
    }
}

impl Part {
    /// Sets the group as a whole, unless it has the values already. `group`: as its program has declared it; `None` if there is none.
    async fn set(&self, own: &Robot, group: Option<Group>) -> Outcome {
        let values = match &group {
            Some(group) => self.whole(group),
            None => self.values.clone(),
        };
        let changes = group.as_ref().map(|group| changes(group, &values));
        if changes.as_ref().is_some_and(Vec::is_empty) {
            return Outcome::Unchanged;
        }
        let changes = changes.unwrap_or_default().join(", ");
        if self.dry_run {
            return match group.as_ref().map(|group| self.check(group)) {
                Some(Ok(())) => Outcome::Set(changes),
                Some(Err(reason)) => Outcome::Failed(format!("refused: {reason}")),
                None => {
                    let group = &self.place.group;
                    Outcome::Failed(format!("refused: no program has the parameters {group}"))
                }
            };
        }
        let order = ParameterOrder::from(values).stored();
        let (robot, group) = (&self.place.robot, &self.place.group);
        match own.set_parameters(robot, group, order).await {
            Ok(_) => Outcome::Set(changes),
            Err(Error::NotStored { reason, .. }) => Outcome::NotStored(changes, reason),
            Err(error) => Outcome::Failed(change::reason(own, &self.place, error).await),
        }
    }

    /// Returns the values of the group as a whole: those that the profile does not name are the defaults.
    fn whole(&self, group: &Group) -> Values {
        let mut values = self.values.clone();
        if !self.keep {
            let declared = group.parameters().iter();
            for parameter in declared.filter(|parameter| !parameter.read_only) {
                let default = || parameter.default.clone();
                values.entry(parameter.name.clone()).or_insert_with(default);
            }
        }
        values
    }

    /// Returns why the program would refuse the values, as far as its declaration states it.
    fn check(&self, group: &Group) -> Result<(), String> {
        let Some(declaration) = &group.declaration else {
            return Ok(());
        };
        let (declared, _) = parameters::Group::new(declaration.clone(), None);
        let order = Order::set(self.values.clone());
        declared.propose(order, false).map(drop)
    }
}

/// Returns what the values change, in words: `kp 1 -> 2`.
fn changes(group: &Group, values: &Values) -> Vec<String> {
    let changed = values.iter().filter_map(|(name, value)| {
        let declaration = group.declaration.as_ref();
        let parameter = declaration.and_then(|declaration| declaration.find(name).ok());
        let accepted = parameter.and_then(|parameter| parameter.accept(value).ok());
        let value: &ParameterValue = accepted.as_ref().unwrap_or(value);
        match parameter.and_then(|parameter| group.value(parameter)) {
            Some(old) if old == *value => None,
            Some(old) => Some(format!("{name} {old} -> {value}")),
            None => Some(format!("{name} = {value}")),
        }
    });
    changed.collect()
}
