//! Tells a second robot of the same name from this robot's own past; plain logic that is given the time.
//!
//! A router that restarts gets another identifier, and its peers may hold the former one until they notice: over TCP for
//! Zenoh's lease of 10 s. So an identifier counts as somebody else once it has been there for longer than that.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

/// How long an identifier is taken for this robot's own past.
const GRACE: Duration = Duration::from_secs(15);

/// Others with this robot's name, by identifier.
#[derive(Debug, Default)]
pub struct Namesakes(BTreeMap<String, Namesake>);

#[derive(Debug)]
struct Namesake {
    since: Instant,
    is_reported: bool,
    is_gone: bool,
}

/// A change among the routers with this robot's name.
#[derive(Debug, PartialEq, Eq)]
pub enum News {
    /// Another one has this robot's name.
    Found(String),
    /// It is gone, or was renamed.
    Gone(String),
}

impl Namesakes {
    /// Somebody with this robot's name is there.
    pub fn on_up(&mut self, id: &str, now: Instant) {
        let namesake = self.0.entry(id.to_owned()).or_insert(Namesake {
            since: now,
            is_reported: false,
            is_gone: false,
        });
        namesake.is_gone = false;
    }

    /// It is gone.
    pub fn on_down(&mut self, id: &str) {
        match self.0.get_mut(id) {
            Some(namesake) if namesake.is_reported => namesake.is_gone = true,
            _ => drop(self.0.remove(id)),
        }
    }

    /// Returns the identifiers of those that are there and are not this robot's own past.
    pub fn there(&self, now: Instant) -> Vec<String> {
        let others = self.0.iter();
        let others = others.filter(|(_, one)| !one.is_gone && now - one.since >= GRACE);
        others.map(|(id, _)| id.clone()).collect()
    }

    /// Returns what has changed since the last call.
    pub fn news(&mut self, now: Instant) -> Vec<News> {
        let mut news = Vec::new();
        self.0.retain(|id, one| {
            if one.is_gone {
                news.push(News::Gone(id.clone()));
            } else if !one.is_reported && now - one.since >= GRACE {
                one.is_reported = true;
                news.push(News::Found(id.clone()));
            }
            !one.is_gone
        });
        news
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restart_is_not_a_second_robot() {
        let (mut namesakes, start) = (Namesakes::default(), Instant::now());
        namesakes.on_up("former", start);
        assert_eq!(namesakes.news(start + GRACE / 2), []);
        namesakes.on_down("former");
        assert_eq!(namesakes.news(start + 2 * GRACE), []);
        assert!(namesakes.there(start + 2 * GRACE).is_empty());
    }

    #[test]
    fn a_second_robot_is_reported_once_and_so_is_its_end() {
        let (mut namesakes, start) = (Namesakes::default(), Instant::now());
        namesakes.on_up("other", start);
        let later = start + GRACE;
        assert_eq!(namesakes.news(later), [News::Found("other".to_owned())]);
        assert_eq!(namesakes.there(later), ["other"]);
        assert_eq!(namesakes.news(later), []);
        namesakes.on_down("other");
        assert!(namesakes.there(later).is_empty());
        assert_eq!(namesakes.news(later), [News::Gone("other".to_owned())]);
        assert_eq!(namesakes.news(later), []);
    }
}
