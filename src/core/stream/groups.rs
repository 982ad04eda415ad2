//! Owns which robots get the frames of which group: those that get much less through than the best are slow, so that a
//! laptop on Wi-Fi is not held down by a robot on Bluetooth. By robot, not by program: the programs of one robot share
//! its link.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use super::Group;
use crate::core::name::Name;

/// Below that share of the best for so long, a robot becomes slow.
const SLOW_BELOW: f64 = 1.0 / 3.0;
const SLOW_AFTER: Duration = Duration::from_secs(2);
/// Above that share for so long, it is no more.
const MAIN_ABOVE: f64 = 0.6;
const MAIN_AFTER: Duration = Duration::from_secs(4);

#[derive(Clone, Copy, Debug)]
struct Member {
    group: Group,
    /// It belongs to the other.
    wrong_since: Option<Instant>,
}

/// Who is where.
#[derive(Clone, Debug, Default)]
pub struct Groups {
    members: BTreeMap<Name, Member>,
}

impl Groups {
    /// Where a robot is.
    pub fn of(&self, robot: &Name) -> Option<Group> {
        self.members.get(robot).map(|member| member.group)
    }

    /// A robot that is not known yet is where it says it is.
    pub fn on_robot(&mut self, robot: &Name, group: Group) {
        let member = Member {
            group,
            wrong_since: None,
        };
        self.members.entry(robot.clone()).or_insert(member);
    }

    /// All of a group.
    pub fn members(&self, group: Group) -> impl Iterator<Item = &Name> {
        let is_there = move |(_, member): &(&Name, &Member)| member.group == group;
        self.members.iter().filter(is_there).map(|(name, _)| name)
    }

    /// So much gets through to each robot, in bytes per second; who is left out is gone. Whether anyone changed groups.
    pub fn update(&mut self, robots: &BTreeMap<Name, f64>, now: Instant) -> bool {
        self.members.retain(|name, _| robots.contains_key(name));
        let best = robots.values().copied().fold(0.0, f64::max);
        let mut has_changed = false;
        for (name, member) in &mut self.members {
            let share = robots.get(name).map_or(1.0, |rate| rate / best.max(1.0));
            let (is_wrong, after) = match member.group {
                Group::Main => (share < SLOW_BELOW, SLOW_AFTER),
                Group::Slow => (share > MAIN_ABOVE, MAIN_AFTER),
            };
            member.wrong_since = is_wrong.then(|| member.wrong_since.unwrap_or(now));
            let lasts = |since: Instant| now.saturating_duration_since(since) >= after;
            if member.wrong_since.is_some_and(lasts) {
                member.wrong_since = None;
                member.group = match member.group {
                    Group::Main => Group::Slow,
                    Group::Slow => Group::Main,
                };
                has_changed = true;
            }
        }
        has_changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> Name {
        Name::new(text).expect("a name")
    }

    fn run(groups: &mut Groups, now: &mut Instant, rates: &[(&str, f64)], seconds: u32) -> u32 {
        let robots = rates
            .iter()
            .map(|&(robot, rate)| (name(robot), rate))
            .collect();
        for &(robot, _) in rates {
            groups.on_robot(&name(robot), Group::Main);
        }
        let mut changes = 0;
        for _ in 0..seconds * 2 {
            *now += Duration::from_millis(500);
            changes += u32::from(groups.update(&robots, *now));
        }
        changes
    }

    #[test]
    fn only_robots_with_much_slower_links_are_parted_and_only_once() {
        let (mut groups, mut now) = (Groups::default(), Instant::now());
        assert_eq!(run(&mut groups, &mut now, &[("a", 29e3)], 20), 0);
        assert_eq!(
            run(&mut groups, &mut now, &[("a", 29e3), ("b", 60e3)], 20),
            0
        );
        let all = [("a", 29e3), ("b", 60e3), ("c", 5e6)];
        assert_eq!(run(&mut groups, &mut now, &all, 60), 1);
        let slow: Vec<_> = groups.members(Group::Slow).cloned().collect();
        assert_eq!(slow, [name("a"), name("b")]);
        assert_eq!(groups.of(&name("c")), Some(Group::Main));
    }

    #[test]
    fn when_the_fast_one_goes_the_others_are_the_main_group() {
        let (mut groups, mut now) = (Groups::default(), Instant::now());
        run(&mut groups, &mut now, &[("a", 29e3), ("c", 5e6)], 10);
        assert_eq!(groups.of(&name("a")), Some(Group::Slow));
        assert_eq!(run(&mut groups, &mut now, &[("a", 29e3)], 10), 1);
        assert_eq!(groups.of(&name("a")), Some(Group::Main));
        assert_eq!(groups.of(&name("c")), None);
    }

    #[test]
    fn between_the_two_bounds_everyone_stays() {
        let (mut groups, mut now) = (Groups::default(), Instant::now());
        for slower in [0.35, 0.5, 0.35, 0.58] {
            let changes = run(
                &mut groups,
                &mut now,
                &[("a", slower * 1e6), ("c", 1e6)],
                20,
            );
            assert_eq!((changes, groups.of(&name("a"))), (0, Some(Group::Main)));
        }
        run(&mut groups, &mut now, &[("a", 0.3e6), ("c", 1e6)], 20);
        for slower in [0.35, 0.5, 0.35, 0.58] {
            let changes = run(
                &mut groups,
                &mut now,
                &[("a", slower * 1e6), ("c", 1e6)],
                20,
            );
            assert_eq!((changes, groups.of(&name("a"))), (0, Some(Group::Slow)));
        }
    }
}
