//! Keeps track of the robots of the fleet by liveliness tokens: declares the token of this robot and observes the tokens of
//! the others. It also detects other routers with this robot's name.
mod name_conflicts;

use std::{collections::HashMap, sync::Arc, time::Instant};

use parking_lot::Mutex;
use zenoh::{
    liveliness::LivelinessToken,
    sample::{Sample, SampleKind},
    Session, Wait,
};

pub use self::name_conflicts::NameConflictEvent;
use self::name_conflicts::NameConflicts;

/// Part of the key of a robot's token: `<fleet>/<robot>/@rect/alive/<id of its router>`.
const ALIVE: &str = "@rect/alive";

/// This robot's token, and the routers of the other robots.
pub struct Presence {
    routers: Arc<Mutex<RouterTable>>,
    _token: LivelinessToken,
}

/// The routers of the fleet, as their tokens name them.
#[derive(Default)]
struct RouterTable {
    /// Names of the robots whose tokens contain a router's identifier, by that identifier. Any robot can put any identifier
    /// into its token: the first robot counts until its token is removed.
    robots: HashMap<String, Vec<String>>,
    name_conflicts: NameConflicts,
}

impl Presence {
    /// Declares this robot's token and observes the others. Calls `on_change` whenever a robot appears or disappears.
    ///
    /// # Errors
    /// Zenoh's error if the token or the subscriber cannot be declared.
    pub fn start(
        session: &Session,
        fleet: &str,
        robot: &str,
        on_change: impl Fn() + Send + Sync + 'static,
    ) -> zenoh::Result<Arc<Self>> {
        let routers = Arc::<Mutex<RouterTable>>::default();
        let (own_name, own_id) = (robot.to_owned(), session.zid().to_string());
        let others = Arc::clone(&routers);
        let on_sample = move |sample: Sample| {
            let key = sample.key_expr().as_str();
            let Some((robot, id)) = robot_and_id(key) else {
                return;
            };
            if id == own_id {
                return;
            }
            let mut routers = others.lock();
            match sample.kind() {
                SampleKind::Put => {
                    on_token(&mut routers.robots, robot, id);
                    if robot == own_name {
                        routers.name_conflicts.on_up(id, Instant::now());
                    }
                }
                SampleKind::Delete => {
                    on_token_removed(&mut routers.robots, robot, id);
                    if robot == own_name {
                        routers.name_conflicts.on_down(id);
                    }
                }
            }
            drop(routers);
            on_change();
        };
        let subscriber = session
            .liveliness()
            .declare_subscriber(format!("{fleet}/*/{ALIVE}/*"));
        let subscriber = subscriber.history(true).callback(on_sample);
        subscriber.background().wait()?;
        let own = format!("{fleet}/{robot}/{ALIVE}/{}", session.zid());
        let token = session.liveliness().declare_token(own).wait()?;
        Ok(Arc::new(Self {
            routers,
            _token: token,
        }))
    }

    /// Returns the name of the robot whose router has the identifier `id`.
    pub fn robot_of(&self, id: &str) -> Option<String> {
        self.routers.lock().robots.get(id)?.first().cloned()
    }

    /// Returns the identifiers of other routers with this robot's name.
    pub fn name_conflicts(&self) -> Vec<String> {
        self.routers.lock().name_conflicts.active(Instant::now())
    }

    /// Returns the changes among other routers with this robot's name since the last call.
    pub fn name_conflict_events(&self) -> Vec<NameConflictEvent> {
        self.routers
            .lock()
            .name_conflicts
            .take_events(Instant::now())
    }
}

fn on_token(robots: &mut HashMap<String, Vec<String>>, robot: &str, id: &str) {
    let names = robots.entry(id.to_owned()).or_default();
    if !names.iter().any(|known| known == robot) {
        names.push(robot.to_owned());
    }
}

fn on_token_removed(robots: &mut HashMap<String, Vec<String>>, robot: &str, id: &str) {
    let Some(names) = robots.get_mut(id) else {
        return;
    };
    names.retain(|known| known != robot);
    if names.is_empty() {
        robots.remove(id);
    }
}

fn robot_and_id(key: &str) -> Option<(&str, &str)> {
    let (robot, id) = key.split_once(&format!("/{ALIVE}/"))?;
    Some((robot.rsplit('/').next()?, id))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_cannot_claim_the_router_of_another_robot() {
        let mut robots = HashMap::new();
        on_token(&mut robots, "wombat-1", "a1b2");
        on_token(&mut robots, "wombat-1", "a1b2");
        on_token(&mut robots, "wombat-2", "a1b2");
        assert_eq!(robots["a1b2"], ["wombat-1", "wombat-2"]);
        on_token_removed(&mut robots, "wombat-2", "a1b2");
        assert_eq!(robots["a1b2"], ["wombat-1"]);
        on_token_removed(&mut robots, "wombat-1", "a1b2");
        on_token_removed(&mut robots, "wombat-1", "a1b2");
        assert!(robots.is_empty());
    }
}
