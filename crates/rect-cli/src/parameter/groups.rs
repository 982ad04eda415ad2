//! Asks robots for their groups of parameters: the declarations from the catalogue, and the values, which are retained.
use std::collections::BTreeSet;

use rect::{Error, Name, Parameter, ParameterValue, Retained, Robot};
use rect_core::{
    parameters::{self, is_name, order::Snapshot, Declaration},
    registry::topics::KEPT,
};
use rect_dashboard::{programs, topics};
use tokio::task::JoinSet;

/// A group of parameters of a robot.
pub struct Group {
    /// The name of the group.
    pub name: String,
    /// The program that has declared it; `None` if it has no name, or has ended.
    pub program: Option<Name>,
    /// The declaration; `None` if the program has ended.
    pub declaration: Option<Declaration>,
    /// The values; `None` if they are not known.
    pub latest: Option<Latest>,
}

/// The values of a group.
#[derive(Clone)]
pub struct Latest {
    /// The values, and who changed them last.
    pub snapshot: Snapshot,
    /// How old they are, and whether their program has ended; `None` if the router does not state it.
    pub retained: Option<Retained>,
}

/// The groups of a robot, or why it did not answer.
pub type Answer = (Name, Result<Vec<Group>, Error>);

impl Group {
    /// Returns whether the program that has declared it has ended.
    pub fn has_ended(&self) -> bool {
        let latest = self.latest.as_ref();
        let retained = latest.and_then(|latest| latest.retained.as_ref());
        self.declaration.is_none() || retained.is_some_and(|retained| retained.has_ended)
    }

    /// Returns the declared parameters; none if the program has ended.
    pub fn parameters(&self) -> &[Parameter] {
        let declaration = self.declaration.as_ref();
        declaration.map_or(&[], Declaration::parameters)
    }

    /// Returns the value of a parameter, as its type.
    pub fn value(&self, parameter: &Parameter) -> Option<ParameterValue> {
        let value = self.latest.as_ref()?.snapshot.values.get(&parameter.name)?;
        Some(parameter.accept(value).unwrap_or_else(|_| value.clone()))
    }
}

/// Returns the last values of a group; `None` if none are kept, or they cannot be read.
pub async fn latest(robot: &Robot, of: &Name, group: &str) -> Result<Option<Latest>, Error> {
    let topic = parameters::topic(group);
    let message = robot.latest::<Snapshot>(of.clone(), topic.as_str()).await?;
    Ok(message.and_then(|message| {
        Some(Latest {
            snapshot: message.value.ok()?,
            retained: message.retained,
        })
    }))
}

/// Asks all reachable robots of the fleet, and that of the router, for the groups of their programs that run. The answers are ordered by
/// the names of the robots. No robot delays another one.
///
/// # Errors
/// Fails if the session is closed.
pub async fn of_fleet(robot: &Robot) -> Result<Vec<Answer>, Error> {
    let mut robots = robot.peers().await?;
    robots.push(robot.name().clone());
    let mut answers = of_robots(robot, robots).await;
    // This computer may be no robot.
    answers.retain(|(name, answer)| {
        !(matches!(answer, Err(Error::NoService { .. })) && name == robot.name())
    });
    Ok(answers)
}

/// Asks robots for the groups of their programs that run.
pub async fn of_robots(robot: &Robot, robots: Vec<Name>) -> Vec<Answer> {
    let mut asking = JoinSet::new();
    for (name, answer) in programs::query(robot, robots).await {
        let robot = robot.clone();
        asking.spawn(async move {
            let answer = match answer {
                Ok(programs) => of_programs(&robot, &name, programs).await,
                Err(error) => Err(error),
            };
            (name, answer)
        });
    }
    let mut answers = asking.join_all().await;
    answers.sort_by(|(one, _), (other, _)| one.cmp(other));
    answers
}

async fn of_programs(
    robot: &Robot,
    of: &Name,
    programs: Vec<rect::Program>,
) -> Result<Vec<Group>, Error> {
    let mut asking = JoinSet::new();
    for program in programs {
        for (group, declaration) in program.parameters() {
            let (robot, of, name) = (robot.clone(), of.clone(), group.to_owned());
            let (program, declaration) = (program.name.clone(), declaration.clone());
            asking.spawn(async move {
                let latest = latest(&robot, &of, &name).await?;
                Ok(Group {
                    name,
                    program,
                    declaration: Some(declaration),
                    latest,
                })
            });
        }
    }
    let groups: Result<Vec<_>, Error> = asking.join_all().await.into_iter().collect();
    let mut groups = groups?;
    groups.sort_by(|one, other| one.name.cmp(&other.name));
    Ok(groups)
}

/// Adds to the answers the groups whose programs have ended, of one robot or of all. Routers list the topics that they keep; a robot
/// whose router does not is left as it is.
pub async fn add_ended(robot: &Robot, of: Option<&Name>, answers: &mut [Answer]) {
    let kept = topics::query(robot, of, None, KEPT)
        .await
        .unwrap_or_default();
    let prefix = parameters::topic("");
    for (name, answer) in answers {
        let Ok(groups) = answer else { continue };
        let running: BTreeSet<_> = groups.iter().map(|group| group.name.clone()).collect();
        let topics = kept.iter().filter(|(robot, _)| robot == name.as_str());
        for report in topics.flat_map(|(_, topics)| &topics.topics) {
            let group = report.topic.strip_prefix(&prefix);
            let Some(group) = group.filter(|group| report.is_retained && is_name(group)) else {
                continue;
            };
            if running.contains(group) {
                continue;
            }
            // Without values there is nothing to show.
            if let Ok(Some(latest)) = latest(robot, name, group).await {
                groups.push(Group {
                    name: group.to_owned(),
                    program: None,
                    declaration: None,
                    latest: Some(latest),
                });
            }
        }
        groups.sort_by(|one, other| one.name.cmp(&other.name));
    }
}
