//! Owns who is there: this robot says so by a liveliness token, and hears the others' of its fleet.
use std::{collections::HashMap, sync::Arc};

use parking_lot::Mutex;
use zenoh::{
    liveliness::LivelinessToken,
    sample::{Sample, SampleKind},
    Session, Wait,
};

/// `<fleet>/<robot>/@rect/alive/<id of its router>`
const ALIVE: &str = "@rect/alive";

/// This robot's token, and whose the identifiers of routers are.
pub struct Presence {
    /// Of each router, the robots whose tokens name it. A robot can put any router's identifier under its own name: the
    /// first one counts, until its own token is gone.
    robots: Arc<Mutex<HashMap<String, Vec<String>>>>,
    _token: LivelinessToken,
}

impl Presence {
    /// From now on this robot is there.
    pub fn start(session: &Session, fleet: &str, robot: &str) -> zenoh::Result<Arc<Self>> {
        let robots = Arc::<Mutex<HashMap<String, Vec<String>>>>::default();
        let heard = Arc::clone(&robots);
        let on_sample = move |sample: Sample| {
            let key = sample.key_expr().as_str();
            let Some((robot, id)) = robot_and_id(key) else {
                return;
            };
            let mut robots = heard.lock();
            match sample.kind() {
                SampleKind::Put => on_token(&mut robots, robot, id),
                SampleKind::Delete => on_token_gone(&mut robots, robot, id),
            }
        };
        let subscriber = session
            .liveliness()
            .declare_subscriber(format!("{fleet}/*/{ALIVE}/*"));
        let subscriber = subscriber.history(true).callback(on_sample);
        subscriber.background().wait()?;
        let own = format!("{fleet}/{robot}/{ALIVE}/{}", session.zid());
        let token = session.liveliness().declare_token(own).wait()?;
        Ok(Arc::new(Self {
            robots,
            _token: token,
        }))
    }

    /// The robot whose router has that identifier.
    pub fn robot_of(&self, id: &str) -> Option<String> {
        self.robots.lock().get(id)?.first().cloned()
    }
}

fn on_token(robots: &mut HashMap<String, Vec<String>>, robot: &str, id: &str) {
    let named = robots.entry(id.to_owned()).or_default();
    if !named.iter().any(|known| known == robot) {
        named.push(robot.to_owned());
    }
}

fn on_token_gone(robots: &mut HashMap<String, Vec<String>>, robot: &str, id: &str) {
    let Some(named) = robots.get_mut(id) else {
        return;
    };
    named.retain(|known| known != robot);
    if named.is_empty() {
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
    fn a_robot_can_not_pass_for_another_ones_router() {
        let mut robots = HashMap::new();
        on_token(&mut robots, "wombat-1", "a1b2");
        on_token(&mut robots, "wombat-1", "a1b2");
        on_token(&mut robots, "wombat-2", "a1b2");
        assert_eq!(robots["a1b2"], ["wombat-1", "wombat-2"]);
        on_token_gone(&mut robots, "wombat-2", "a1b2");
        assert_eq!(robots["a1b2"], ["wombat-1"]);
        on_token_gone(&mut robots, "wombat-1", "a1b2");
        on_token_gone(&mut robots, "wombat-1", "a1b2");
        assert!(robots.is_empty());
    }
}
