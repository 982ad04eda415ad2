//! Decides which retained values a subscription delivers: those that are published, and those that the router has. Each is delivered once,
//! and none after a newer one.
use std::collections::BTreeMap;

use super::{live::Live, value::Value, Origin, Position};
use crate::name::{topic::Topic, Name};

/// The retained values that a subscription has delivered.
#[derive(Debug, Default)]
pub(crate) struct RetainedOrder {
    last: BTreeMap<(Name, Topic), Last>,
    /// The run of each robot's router, as the program's own router says. Messages of another run are older, or newer than what is known:
    /// then the own router delivers them.
    runs: BTreeMap<Name, u32>,
}

/// The last value of a topic.
#[derive(Clone, Copy, Debug)]
struct Last {
    origin: Origin,
    /// The position at the router of its robot.
    at: Position,
    is_forgotten: bool,
    /// The run of the program's router that had it.
    router: Option<u32>,
}

impl RetainedOrder {
    /// Returns whether to deliver a value that this run of the program's router has.
    pub fn on_value(&mut self, value: &Value, router: u32) -> bool {
        let (Some(robot), Some(at)) = (value.robot.clone(), value.kept) else {
            return false;
        };
        self.runs.insert(robot.clone(), at.0);
        let key = (robot, value.topic.clone());
        let before = self.last.get_mut(&key);
        if let Some(before) = before {
            before.router = Some(router);
            if before.at.0 == at.0 && before.at.1 >= at.1 {
                return false;
            }
        }
        let last = Last {
            origin: value.origin,
            at,
            is_forgotten: value.is_forgotten,
            router: Some(router),
        };
        let before = self.last.insert(key, last);
        let had_value = before.is_some_and(|before| !before.is_forgotten);
        match value.is_forgotten {
            true => had_value,
            false => !had_value || before.is_none_or(|before| before.origin != value.origin),
        }
    }

    /// Returns whether to deliver a value that is published, or that a topic is forgotten.
    pub fn on_live(&mut self, robot: &Name, topic: &Topic, live: Live, is_forgotten: bool) -> bool {
        let at = live.position;
        if self.runs.get(robot) != Some(&at.0) {
            return false;
        }
        let key = (robot.clone(), topic.clone());
        let before = self.last.get(&key).copied();
        if before.is_some_and(|before| before.at.0 == at.0 && before.at.1 >= at.1) {
            return false;
        }
        let last = Last {
            origin: live.origin,
            at,
            is_forgotten,
            router: None,
        };
        self.last.insert(key, last);
        !is_forgotten || before.is_some_and(|before| !before.is_forgotten)
    }

    /// Handles that this run of the program's router has all values of a robot up to a position. Returns the topics that are forgotten.
    pub fn on_complete(&mut self, robot: &Name, at: Position, router: u32) -> Vec<Topic> {
        self.runs.insert(robot.clone(), at.0);
        let is_gone = |last: &Last| {
            let is_other_run = last.at.0 != at.0;
            is_other_run || (last.at.1 <= at.1 && last.router != Some(router))
        };
        let of_robot = self.last.iter().filter(|((of, _), _)| of == robot);
        let gone = of_robot.filter(|(_, last)| is_gone(last));
        let gone: Vec<_> = gone.map(|((_, topic), _)| topic.clone()).collect();
        let mut forget = |topic: &Topic| {
            let last = self.last.remove(&(robot.clone(), topic.clone()));
            last.is_some_and(|last| !last.is_forgotten)
        };
        gone.into_iter().filter(|topic| forget(topic)).collect()
    }
}
