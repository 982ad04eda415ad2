//! Knows which robots have asked for which messages.
use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use zenoh_keyexpr::{keyexpr, OwnedKeyExpr};

use crate::{
    message::throttled::{of_token, Wish},
    name::{key::KeySpace, Name},
};

/// The maximum number of wishes of a robot.
pub const MAX_WISHES: usize = 256;
/// The maximum number of robots with wishes.
pub const MAX_ROBOTS: usize = 64;
/// The number of topics whose routes are remembered.
const MAX_ROUTES: usize = 1024;

/// The wishes of other robots, and of this one.
#[derive(Debug, Default)]
pub(super) struct Wishes {
    robots: BTreeMap<Name, BTreeSet<(String, Wish)>>,
    /// Where the messages of each topic go.
    routes: BTreeMap<String, Vec<Route>>,
}

/// That a robot has asked for a topic.
#[derive(Clone, Debug)]
pub(super) struct Route {
    pub(super) receiver: Name,
    /// The key expression that the robot has asked for. Of several ones, the first.
    pub(super) pattern: String,
    pub(super) asked: Asked,
}

/// The largest wish of the subscribers of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Asked {
    /// The shortest interval between two messages that one of them wants.
    pub(super) interval: Duration,
    /// The longest one.
    pub(super) slowest: Duration,
    /// Whether none wants a message whose value equals the last one.
    pub(super) on_change: bool,
}

impl Wishes {
    /// Handles a token. Returns whether the wishes have changed.
    ///
    /// # Errors
    /// Returns why a wish is not known, for a person.
    pub(super) fn on_token(
        &mut self,
        place: &KeySpace,
        key: &str,
        is_deleted: bool,
    ) -> Result<bool, String> {
        let Some((receiver, wish, topic)) = of_token(place, key) else {
            return Ok(false);
        };
        if OwnedKeyExpr::new(topic).is_err() {
            return Ok(false);
        }
        let known = (topic.to_owned(), wish);
        if is_deleted {
            let Some(wishes) = self.robots.get_mut(&receiver) else {
                return Ok(false);
            };
            let was_known = wishes.remove(&known);
            if wishes.is_empty() {
                self.robots.remove(&receiver);
            }
            self.routes.clear();
            return Ok(was_known);
        }
        if self.robots.len() >= MAX_ROBOTS && !self.robots.contains_key(&receiver) {
            return Err(format!("more than {MAX_ROBOTS} robots have asked for messages with max_hz or on_change: {receiver} gets none"));
        }
        let wishes = self.robots.entry(receiver.clone()).or_default();
        if wishes.len() >= MAX_WISHES && !wishes.contains(&known) {
            return Err(format!("{receiver} has asked for more than {MAX_WISHES} topics and rates with max_hz or on_change: it gets no messages of {topic}"));
        }
        self.routes.clear();
        Ok(wishes.insert(known))
    }

    /// Returns the key expressions that robots have asked for.
    pub(super) fn patterns(&self) -> BTreeSet<&str> {
        let wishes = self.robots.values().flatten();
        wishes.map(|(pattern, _)| pattern.as_str()).collect()
    }

    /// Returns the robots that have asked for a topic.
    pub(super) fn routes(&mut self, topic: &str) -> &[Route] {
        if !self.routes.contains_key(topic) {
            let robots = self.robots.keys();
            let routes = robots
                .filter_map(|receiver| self.route(topic, receiver))
                .collect();
            if self.routes.len() >= MAX_ROUTES {
                self.routes.clear();
            }
            self.routes.insert(topic.to_owned(), routes);
        }
        self.routes.get(topic).map_or(&[], Vec::as_slice)
    }

    /// Returns what a robot has asked for, if it has asked for the topic.
    pub(super) fn route(&self, topic: &str, receiver: &Name) -> Option<Route> {
        let topic = keyexpr::new(topic).ok()?;
        let mut route = None::<Route>;
        for (pattern, wish) in self.robots.get(receiver)? {
            if !keyexpr::new(pattern).is_ok_and(|pattern| pattern.includes(topic)) {
                continue;
            }
            let route = route.get_or_insert_with(|| Route {
                receiver: receiver.clone(),
                pattern: pattern.clone(),
                asked: Asked::NOTHING,
            });
            let asked = &mut route.asked;
            asked.interval = asked.interval.min(wish.interval());
            asked.slowest = asked.slowest.max(wish.interval());
            asked.on_change &= wish.is_on_change();
        }
        route
    }
}
