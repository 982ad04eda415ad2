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
    robots: Arc<Mutex<HashMap<String, String>>>,
    _token: LivelinessToken,
}

impl Presence {
    /// From now on this robot is there.
    pub fn start(session: &Session, fleet: &str, robot: &str) -> zenoh::Result<Arc<Self>> {
        let robots = Arc::<Mutex<HashMap<String, String>>>::default();
        let heard = Arc::clone(&robots);
        let on_sample = move |sample: Sample| {
            let key = sample.key_expr().as_str();
            let Some((robot, id)) = robot_and_id(key) else {
                return;
            };
            let mut robots = heard.lock();
            match sample.kind() {
                SampleKind::Put => drop(robots.insert(id.to_owned(), robot.to_owned())),
                SampleKind::Delete => drop(robots.remove(id)),
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
        self.robots.lock().get(id).cloned()
    }
}

fn robot_and_id(key: &str) -> Option<(&str, &str)> {
    let (robot, id) = key.split_once(&format!("/{ALIVE}/"))?;
    Some((robot.rsplit('/').next()?, id))
}
