//! Distinguishes a second robot of the same name from a previous run of this robot's router. The logic does no I/O; the
//! caller passes the time.
//!
//! A router that restarts gets a new identifier, and its peers may keep the old one until they detect the restart: over TCP
//! for Zenoh's lease of 10 s. An identifier therefore counts as another robot only once it has been present for longer.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

/// Time for which an identifier is assumed to be a previous run of this robot's router.
const GRACE: Duration = Duration::from_secs(15);

/// Other routers with this robot's name, by identifier.
#[derive(Debug, Default)]
pub struct NameConflicts(BTreeMap<String, NameConflict>);

#[derive(Debug)]
struct NameConflict {
    since: Instant,
    is_reported: bool,
    has_disappeared: bool,
}

/// A change among the other routers with this robot's name.
#[derive(Debug, PartialEq, Eq)]
pub enum NameConflictEvent {
    /// The router with this identifier has this robot's name.
    Found(String),
    /// The router with this identifier has disappeared or was renamed.
    Resolved(String),
}

impl NameConflicts {
    /// Records that a router with this robot's name has appeared.
    pub fn on_up(&mut self, id: &str, now: Instant) {
        let conflict = self.0.entry(id.to_owned()).or_insert(NameConflict {
            since: now,
            is_reported: false,
            has_disappeared: false,
        });
        conflict.has_disappeared = false;
    }

    /// Records that a router with this robot's name has disappeared.
    pub fn on_down(&mut self, id: &str) {
        match self.0.get_mut(id) {
            Some(conflict) if conflict.is_reported => conflict.has_disappeared = true,
            _ => drop(self.0.remove(id)),
        }
    }

    /// Returns the identifiers of the routers that are present and have been for longer than the grace period.
    pub fn active(&self, now: Instant) -> Vec<String> {
        let others = self.0.iter();
        let others = others
            .filter(|(_, conflict)| !conflict.has_disappeared && now - conflict.since >= GRACE);
        others.map(|(id, _)| id.clone()).collect()
    }

    /// Returns the changes since the last call.
    pub fn take_events(&mut self, now: Instant) -> Vec<NameConflictEvent> {
        let mut events = Vec::new();
        self.0.retain(|id, conflict| {
            if conflict.has_disappeared {
                events.push(NameConflictEvent::Resolved(id.clone()));
            } else if !conflict.is_reported && now - conflict.since >= GRACE {
                conflict.is_reported = true;
                events.push(NameConflictEvent::Found(id.clone()));
            }
            !conflict.has_disappeared
        });
        events
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restart_is_not_reported() {
        let (mut name_conflicts, start) = (NameConflicts::default(), Instant::now());
        name_conflicts.on_up("former", start);
        assert_eq!(name_conflicts.take_events(start + GRACE / 2), []);
        name_conflicts.on_down("former");
        assert_eq!(name_conflicts.take_events(start + 2 * GRACE), []);
        assert!(name_conflicts.active(start + 2 * GRACE).is_empty());
    }

    #[test]
    fn a_second_robot_and_its_end_are_each_reported_once() {
        let (mut name_conflicts, start) = (NameConflicts::default(), Instant::now());
        name_conflicts.on_up("other", start);
        let later = start + GRACE;
        assert_eq!(
            name_conflicts.take_events(later),
            [NameConflictEvent::Found("other".to_owned())]
        );
        assert_eq!(name_conflicts.active(later), ["other"]);
        assert_eq!(name_conflicts.take_events(later), []);
        name_conflicts.on_down("other");
        assert!(name_conflicts.active(later).is_empty());
        assert_eq!(
            name_conflicts.take_events(later),
            [NameConflictEvent::Resolved("other".to_owned())]
        );
        assert_eq!(name_conflicts.take_events(later), []);
    }
}
