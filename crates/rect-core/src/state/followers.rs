//! The routers of other robots that have copies of this robot's values, and whether they have the last ones.
//!
//! A published value can be lost: with a link for which another one takes over at once, or over UDP. So after the last of several changes
//! each of these routers is asked once whether it has all values, until it answers or has left. Nothing is asked while nothing changes.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use zenoh_keyexpr::OwnedKeyExpr;

use super::page::MAX_KEYS;
use crate::{driver::Id, name::Name};

/// The time without changes after which the routers are asked.
const QUIET: Duration = Duration::from_secs(1);
/// The time after which they are asked although there are changes.
const LONGEST: Duration = Duration::from_secs(10);
/// The first pause before a router that has not answered is asked again. Each following one is three times as long.
const PAUSE: Duration = Duration::from_secs(2);
/// How often a router is asked that does not answer. It asks by itself when it is back.
const ATTEMPTS: u32 = 4;
/// The maximum number of routers.
const MAX_FOLLOWERS: usize = 256;

#[derive(Debug)]
struct Follower {
    keys: Vec<OwnedKeyExpr>,
    /// When it is asked next, if it is to be asked.
    ask_at: Option<Instant>,
    /// The first change since it was asked.
    changed: Option<Instant>,
    attempts: u32,
    asking: Option<Id>,
}

/// The routers.
#[derive(Debug, Default)]
pub(super) struct Followers(BTreeMap<Name, Follower>);

impl Followers {
    /// Handles that a router has asked for the values of those topics. `adds`: it has others beside them.
    pub(super) fn add(&mut self, robot: Name, keys: Vec<OwnedKeyExpr>, adds: bool) {
        if self.0.len() >= MAX_FOLLOWERS && !self.0.contains_key(&robot) {
            return;
        }
        let follower = self.0.entry(robot).or_insert(Follower {
            keys: Vec::new(),
            ask_at: None,
            changed: None,
            attempts: 0,
            asking: None,
        });
        let is_replaced =
            |known: &OwnedKeyExpr| !adds || keys.iter().any(|key| key.includes(known));
        follower.keys.retain(|known| !is_replaced(known));
        follower.keys.extend(keys);
        follower.keys.truncate(MAX_KEYS);
    }

    /// Handles a change that those routers have to know whose topics `select` selects.
    pub(super) fn on_change(&mut self, now: Instant, select: impl Fn(&[OwnedKeyExpr]) -> bool) {
        for follower in self.0.values_mut() {
            if select(&follower.keys) {
                let first = *follower.changed.get_or_insert(now);
                follower.ask_at = Some((now + QUIET).min(first + LONGEST));
                follower.attempts = 0;
            }
        }
    }

    /// Returns the next router to ask.
    pub(super) fn due(&mut self, now: Instant, id: impl FnOnce() -> Id) -> Option<(Id, Name)> {
        let mut all = self.0.iter_mut();
        let is_due = |follower: &Follower| {
            follower.asking.is_none() && follower.ask_at.is_some_and(|at| at <= now)
        };
        let (robot, follower) = all.find(|(_, follower)| is_due(follower))?;
        let id = id();
        (follower.ask_at, follower.changed, follower.asking) = (None, None, Some(id));
        Some((id, robot.clone()))
    }

    /// Returns the topics of a router.
    pub(super) fn keys(&self, robot: &Name) -> &[OwnedKeyExpr] {
        self.0.get(robot).map_or(&[], |follower| &follower.keys)
    }

    /// Handles the answer of a router: it has all values, or asks for them itself. `has_left`: it has no copies any more.
    pub(super) fn on_answer(&mut self, id: Id, has_left: bool) {
        let mut all = self.0.iter_mut();
        let Some((robot, follower)) = all.find(|(_, follower)| follower.asking == Some(id)) else {
            return;
        };
        follower.asking = None;
        if has_left {
            let robot = robot.clone();
            self.0.remove(&robot);
        }
    }

    /// Handles that a question has ended. A router that has not answered is asked again.
    pub(super) fn on_ended(&mut self, id: Id, now: Instant) {
        let mut all = self.0.iter_mut();
        let Some((robot, follower)) = all.find(|(_, follower)| follower.asking == Some(id)) else {
            return;
        };
        follower.asking = None;
        follower.attempts += 1;
        if follower.attempts >= ATTEMPTS {
            let robot = robot.clone();
            self.0.remove(&robot);
            return;
        }
        let again = now + PAUSE * 3u32.pow(follower.attempts - 1);
        follower.ask_at = Some(follower.ask_at.map_or(again, |at| at.min(again)));
    }

    /// Returns when [`due`](Self::due) has something next.
    pub(super) fn next(&self) -> Option<Instant> {
        let idle = self.0.values().filter(|follower| follower.asking.is_none());
        idle.filter_map(|follower| follower.ask_at).min()
    }
}
