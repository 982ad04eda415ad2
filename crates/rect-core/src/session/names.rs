//! Describes names that there are, for a program that uses one that there is not.
use crate::{name::Name, text::names::in_words};

/// The beginning of internal topics, which says nothing to people.
const INTERNAL: &str = "@rect/@set/";

/// Returns in words which robots are reachable, for a program that uses one that is not.
pub fn reachable_robots(robot: &Name, reachable: &[Name]) -> String {
    let names = reachable.iter().map(Name::as_str);
    in_words("reachable robots", robot.as_str(), names)
}

/// Returns the error that no program serves `topic` at a robot, or in the fleet (`None`).
pub fn no_service(robot: Option<&Name>, topic: &str, reachable: &[Name]) -> String {
    match robot {
        Some(robot) => {
            let reachable = reachable_robots(robot, reachable);
            format!("no program serves {topic} at {robot}; {reachable}")
        }
        None => {
            let names = reachable.iter().map(Name::as_str);
            let reachable = in_words("reachable robots", "", names);
            format!("no program of the fleet serves {topic}; {reachable}")
        }
    }
}

/// Returns the error that a robot, or all robots (`None`), did not reply to the request `topic`, which may have been carried out.
pub fn interrupted(robot: Option<&Name>, topic: &str) -> String {
    let topic = topic.strip_prefix(INTERNAL).unwrap_or(topic);
    let (nobody, its) = match robot {
        Some(robot) => (format!("{robot} did not reply"), "its"),
        None => ("no robot replied".to_owned(), "the"),
    };
    format!(
        "{nobody} to the request {topic}, which may have been carried out: {its} program, a router or the link ended meanwhile. Check \
         before you send it again"
    )
}

/// Returns the description of the problem that a robot, to which a program sends, is not reachable.
pub fn not_reachable(robot: &Name, reachable: &[Name]) -> String {
    let names = reachable_robots(robot, reachable);
    format!("{robot} is not reachable; {names}")
}

/// Returns the error that a robot has no group of parameters of that name.
pub fn no_parameters(robot: &Name, group: &str, available: &[String]) -> String {
    if available.iter().any(|known| known == group) {
        return format!(
            "{robot} has the parameters {group}, and the access control of a router on the way lets nobody change them: it needs the key \
             expression <fleet>/*/@rect/@set/parameters/** (docs/how-to/tune.md)"
        );
    }
    let names = available.iter().map(String::as_str);
    let groups = in_words("its groups", group, names);
    format!("no program of {robot} has the parameters {group}; {groups}")
}

/// Returns the error that a robot has no action of that name.
pub fn no_action(robot: &Name, action: &str, available: &[String]) -> String {
    if available.iter().any(|known| known == action) {
        return format!(
            "{robot} has the action {action}, and the access control of a router on the way lets nobody start it: it needs the key \
             expression <fleet>/*/@rect/@set/actions/** (docs/how-to/long-tasks.md)"
        );
    }
    if available.is_empty() {
        return format!(
            "no program of {robot} has the action {action}, nor any other one: is the robot reachable, and its program running?"
        );
    }
    let names = available.iter().map(String::as_str);
    let actions = in_words("its actions", action, names);
    format!("no program of {robot} has the action {action}; {actions}")
}
