//! Shows the parameters of programs in viewers, which may change them if that is permitted, and the named connections of the robot's router.
mod changes;
mod connections;
mod value;

use std::collections::BTreeMap;

use foxglove::websocket::{
    AnyClient, GetParametersResponder, Parameter, ParameterHandler, SetParametersResponder,
};
use rect::{Error, Message, Name, ParameterValue, Pattern, Robot, Subscriber};
use rect_core::parameters::{self, order::Snapshot};
use tokio::runtime::Handle;

use self::changes::{Change, Changes};
pub use self::connections::all as connections;
use crate::parameter::groups;

/// The parameters that are shown in viewers.
#[derive(Clone)]
pub struct Shown {
    /// The patterns of the topics that viewers are offered; without patterns, all.
    patterns: Vec<Pattern>,
}

/// Answers viewers that ask for parameters, or change them.
pub struct Parameters {
    robot: Robot,
    shown: Shown,
    /// The changes of viewers; `None` if they may not change parameters.
    changes: Option<Changes>,
    runtime: Handle,
}

impl Shown {
    /// Selects the groups whose topics match one of the patterns; without patterns, all.
    pub fn new(patterns: Vec<Pattern>) -> Self {
        Self { patterns }
    }

    fn selects(&self, robot: &Name, group: &str) -> bool {
        let topic = format!("{robot}/{}", parameters::topic(group));
        self.patterns.is_empty() || self.patterns.iter().any(|pattern| pattern.matches(&topic))
    }

    /// Subscribes to the values of all groups.
    ///
    /// # Errors
    /// Fails if the session is closed.
    pub async fn subscribe(robot: &Robot) -> Result<Subscriber<Snapshot>, Error> {
        let pattern = format!("*/{}", parameters::topic("*"));
        robot.subscribe(pattern.as_str()).await
    }

    /// Returns the parameters with the new values of a group; empty if the group is not shown, or its program has ended.
    pub fn on_message(&self, message: Message<Snapshot>) -> Vec<Parameter> {
        let has_ended = message.retained.as_ref();
        let has_ended =
            has_ended.is_some_and(|retained| retained.has_ended || retained.is_forgotten);
        let topic = message.topic.as_str();
        let group = topic.rsplit('/').next().unwrap_or(topic);
        match message.value {
            Ok(snapshot) if !has_ended && self.selects(&message.sender, group) => {
                of_group(&message.sender, group, &snapshot.values)
            }
            _ => Vec::new(),
        }
    }
}

/// Returns the parameters with values of a group.
fn of_group(
    robot: &Name,
    group: &str,
    values: &BTreeMap<String, ParameterValue>,
) -> Vec<Parameter> {
    let values = values.iter();
    let values =
        values.map(|(name, value)| value::parameter(format!("{robot}/{group}/{name}"), value));
    values.collect()
}

impl Parameters {
    /// Creates the answers. Call it on a tokio runtime. `may_change`: whether viewers may change parameters.
    pub fn new(robot: Robot, shown: Shown, may_change: bool) -> Self {
        Self {
            changes: may_change.then(|| Changes::new(robot.clone())),
            shown,
            robot,
            runtime: Handle::current(),
        }
    }

    /// Returns the changes that a viewer asks for, one for each group.
    ///
    /// # Errors
    /// Returns why they are not possible.
    fn requested(&self, parameters: Vec<Parameter>) -> Result<(&Changes, Vec<Change>), String> {
        let mut requested: Vec<Change> = Vec::new();
        for parameter in parameters {
            let name = parameter.name.as_str();
            let Some((robot, group, parameter_name)) = parts(name) else {
                return Err(
                    "connections are changed with `rect connect` and `rect disconnect`, or in `rect dashboard`"
                        .to_owned(),
                );
            };
            if !self.shown.selects(&robot, group) {
                return Err(format!("there is no parameter {name}"));
            }
            let value = value::read(parameter.value.as_ref());
            let value = value.map_err(|reason| format!("{name}: {reason}"))?;
            let place = requested
                .iter_mut()
                .find(|change| change.robot == robot && change.group == group);
            match place {
                Some(change) => {
                    change.values.insert(parameter_name.to_owned(), value);
                }
                None => requested.push(Change {
                    group: group.to_owned(),
                    values: [(parameter_name.to_owned(), value)].into(),
                    robot,
                }),
            }
        }
        match &self.changes {
            Some(changes) => Ok((changes, requested)),
            None => {
                let names = requested
                    .iter()
                    .map(|change| format!("{}/{}", change.robot, change.group));
                let names: Vec<_> = names.collect();
                Err(format!(
                    "{} cannot be changed by viewers: start `rect foxglove` with --publish to permit it",
                    names.join(", ")
                ))
            }
        }
    }
}

/// Returns the robot, the group and the name of a program's parameter; `None` for a connection.
fn parts(name: &str) -> Option<(Name, &str, &str)> {
    let mut parts = name.splitn(3, '/');
    let (robot, group, name) = (parts.next()?, parts.next()?, parts.next()?);
    let are_names = [group, name].into_iter().all(parameters::is_name);
    Some((Name::new(robot).ok().filter(|_| are_names)?, group, name))
}

impl ParameterHandler for Parameters {
    fn get(
        &self,
        client: AnyClient,
        names: Vec<String>,
        _request_id: Option<String>,
        responder: GetParametersResponder,
    ) {
        let (robot, shown) = (self.robot.clone(), self.shown.clone());
        self.runtime.spawn(async move {
            let mut parameters = all(&robot, &shown).await.unwrap_or_else(|error| {
                client.send_error(error.to_string());
                Vec::new()
            });
            parameters.retain(|parameter| names.is_empty() || names.contains(&parameter.name));
            responder.respond(parameters);
        });
    }

    fn set(
        &self,
        client: AnyClient,
        parameters: Vec<Parameter>,
        _request_id: Option<String>,
        responder: SetParametersResponder,
    ) {
        let (changes, requested) = match self.requested(parameters) {
            Ok(requested) => requested,
            Err(problem) => {
                client.send_error(problem);
                return responder.respond(Vec::new());
            }
        };
        // In the order in which viewers send them.
        let outcomes: Vec<_> = requested
            .into_iter()
            .map(|change| changes.begin(change))
            .collect();
        self.runtime.spawn(async move {
            let mut in_force = Vec::new();
            for outcome in outcomes {
                match outcome.await {
                    Ok(parameters) => in_force.extend(parameters),
                    Err(problem) => client.send_error(problem),
                }
            }
            responder.respond(in_force);
        });
    }
}

/// Returns all parameters: those of the programs that run on reachable robots, and the connections.
async fn all(robot: &Robot, shown: &Shown) -> Result<Vec<Parameter>, Error> {
    let mut all = connections(robot).await?;
    // A robot that does not answer has no parameters to show.
    for (name, groups) in groups::of_fleet(robot).await? {
        for group in groups.unwrap_or_default() {
            let latest = group.latest.filter(|_| shown.selects(&name, &group.name));
            all.extend(
                latest
                    .iter()
                    .flat_map(|latest| of_group(&name, &group.name, &latest.snapshot.values)),
            );
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_parameters_or_connections() {
        let (robot, group, name) = parts("wombat-2/drive/kp").expect("a parameter");
        assert_eq!((robot.as_str(), group, name), ("wombat-2", "drive", "kp"));
        for name in ["connections/base", "kp", "", "a/b/c/d", "a//b", "a b/c/d"] {
            assert_eq!(parts(name), None, "{name}");
        }
    }

    #[test]
    fn patterns_select_groups_by_their_topics() {
        let robot = Name::new("wombat-2").expect("a name");
        let selects = |patterns: &[&str]| {
            let patterns = patterns
                .iter()
                .map(|pattern| Pattern::new(pattern).expect("a pattern"));
            Shown::new(patterns.collect()).selects(&robot, "drive")
        };
        assert!(selects(&[]));
        assert!(selects(&["wombat-1/**", "wombat-2/parameters/drive"]));
        assert!(selects(&["*/parameters/*"]));
        assert!(!selects(&["wombat-1/**", "wombat-2/camera"]));
    }
}
