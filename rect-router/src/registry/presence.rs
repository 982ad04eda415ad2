//! Owns who is there: this robot says so by a liveliness token, and hears the others' of its fleet. Another router with
//! this robot's own name is found here, too.
mod namesakes;

use std::{collections::HashMap, sync::Arc, time::Instant};

use parking_lot::Mutex;
use zenoh::{
    liveliness::LivelinessToken,
    sample::{Sample, SampleKind},
    Session, Wait,
};

use self::namesakes::Namesakes;
pub use self::namesakes::News;

/// `<fleet>/<robot>/@rect/alive/<id of its router>`
const ALIVE: &str = "@rect/alive";

/// This robot's token, and whose the identifiers of routers are.
pub struct Presence {
    heard: Arc<Mutex<Heard>>,
    _token: LivelinessToken,
}

#[derive(Default)]
struct Heard {
    /// The robots whose tokens name a router, by the router's identifier. A robot can put any router's identifier under its
    /// own name: the first one counts, until its own token is gone.
    robots: HashMap<String, Vec<String>>,
    namesakes: Namesakes,
}

impl Presence {
    /// From now on this robot is there. Calls `on_change` when another one comes or goes.
    pub fn start(
        session: &Session,
        fleet: &str,
        robot: &str,
        on_change: impl Fn() + Send + Sync + 'static,
    ) -> zenoh::Result<Arc<Self>> {
        let heard = Arc::<Mutex<Heard>>::default();
        let (own_name, own_id) = (robot.to_owned(), session.zid().to_string());
        let others = Arc::clone(&heard);
        let on_sample = move |sample: Sample| {
            let key = sample.key_expr().as_str();
            let Some((robot, id)) = robot_and_id(key) else {
                return;
            };
            if id == own_id {
                return;
            }
            let mut heard = others.lock();
            match sample.kind() {
                SampleKind::Put => {
                    on_token(&mut heard.robots, robot, id);
                    if robot == own_name {
                        heard.namesakes.on_up(id, Instant::now());
                    }
                }
                SampleKind::Delete => {
                    on_token_gone(&mut heard.robots, robot, id);
                    if robot == own_name {
                        heard.namesakes.on_down(id);
                    }
                }
            }
            drop(heard);
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
            heard,
            _token: token,
        }))
    }

    /// The robot whose router has that identifier.
    pub fn robot_of(&self, id: &str) -> Option<String> {
        self.heard.lock().robots.get(id)?.first().cloned()
    }

    /// Returns the identifiers of others with this robot's name.
    pub fn namesakes(&self) -> Vec<String> {
        self.heard.lock().namesakes.there(Instant::now())
    }

    /// Returns what has changed about others with this robot's name since the last call.
    pub fn news_of_namesakes(&self) -> Vec<News> {
        self.heard.lock().namesakes.news(Instant::now())
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
