//! Owns which robots get the frames of which group: those that get much less through than the best are slow, so that a
//! laptop on Wi-Fi is not held down by a robot on Bluetooth. By robot, not by program: the programs of one robot share
//! its link.
//!
//! A robot's group follows from what it reports, which may be wrong or forged. So a robot that was moved counts in the group
//! that it leaves for a few seconds only, whatever it reports, and one that was slow again and again waits longer each time
//! before it may hold down the others once more.
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
/// A robot that became slow more than once waits twice as long each time, this often at most.
const MAX_DOUBLINGS: u32 = 4;
/// A robot that was not slow for so long, or is gone for so long, begins anew.
const REMEMBERED: Duration = Duration::from_secs(60);

#[derive(Clone, Copy, Debug)]
struct Member {
    group: Group,
    /// It belongs to the other.
    wrong_since: Option<Instant>,
    /// When it was moved out of the other group.
    moved: Option<Instant>,
    /// How often it became slow, lately.
    slowdowns: u32,
    gone_since: Option<Instant>,
}

/// Who is where.
#[derive(Clone, Debug, Default)]
pub struct Groups {
    members: BTreeMap<Name, Member>,
}

impl Groups {
    /// Where a robot is.
    pub fn of(&self, robot: &Name) -> Option<Group> {
        let member = self.members.get(robot)?;
        member.gone_since.is_none().then_some(member.group)
    }

    /// A robot that is not known yet is there.
    pub fn on_robot(&mut self, robot: &Name, group: Group) {
        let member = Member {
            group,
            wrong_since: None,
            moved: None,
            slowdowns: 0,
            gone_since: None,
        };
        let member = self.members.entry(robot.clone()).or_insert(member);
        member.gone_since = None;
    }

    /// Whether a robot was moved out of that group no longer ago than `within`, so that it may still listen there.
    pub fn is_leaving(&self, robot: &Name, group: Group, within: Duration, now: Instant) -> bool {
        let is_recent = |moved: Instant| now.saturating_duration_since(moved) < within;
        let member = self.members.get(robot);
        member.is_some_and(|member| member.group != group && member.moved.is_some_and(is_recent))
    }

    /// All of a group.
    pub fn members(&self, group: Group) -> impl Iterator<Item = &Name> {
        let is_there = move |(_, member): &(&Name, &Member)| {
            member.group == group && member.gone_since.is_none()
        };
        self.members.iter().filter(is_there).map(|(name, _)| name)
    }

    /// So much gets through to each robot, in bytes per second; who is left out is gone. Whether anyone changed groups.
    pub fn update(&mut self, robots: &BTreeMap<Name, f64>, now: Instant) -> bool {
        let is_recent = |since: Instant| now.saturating_duration_since(since) < REMEMBERED;
        self.members.retain(|name, member| {
            if robots.contains_key(name) {
                return true;
            }
            member.wrong_since = None;
            is_recent(*member.gone_since.get_or_insert(now))
        });
        let best = robots.values().copied().fold(0.0, f64::max);
        let mut has_changed = false;
        for (name, member) in &mut self.members {
            if member.gone_since.is_some() {
                continue;
            }
            let share = robots.get(name).map_or(1.0, |rate| rate / best.max(1.0));
            let (is_wrong, after) = match member.group {
                Group::Main => (share < SLOW_BELOW, SLOW_AFTER),
                Group::Slow => (share > MAIN_ABOVE, member.main_after()),
            };
            member.wrong_since = is_wrong.then(|| member.wrong_since.unwrap_or(now));
            let lasts = |since: Instant| now.saturating_duration_since(since) >= after;
            if member.wrong_since.is_some_and(lasts) {
                member.wrong_since = None;
                member.group = match member.group {
                    Group::Main => {
                        let again = member.moved.is_some_and(is_recent);
                        member.slowdowns = 1 + if again { member.slowdowns } else { 0 };
                        Group::Slow
                    }
                    Group::Slow => Group::Main,
                };
                member.moved = Some(now);
                has_changed = true;
            }
        }
        has_changed
    }
}

impl Member {
    /// How long it must get enough through before it is slow no more.
    fn main_after(&self) -> Duration {
        MAIN_AFTER * 2u32.pow(self.slowdowns.saturating_sub(1).min(MAX_DOUBLINGS))
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

    #[test]
    fn a_robot_that_is_slow_again_and_again_waits_longer_each_time() {
        let (mut groups, mut now) = (Groups::default(), Instant::now());
        let mut seconds = Vec::new();
        for _ in 0..8 {
            run(&mut groups, &mut now, &[("a", 1.0), ("c", 1e6)], 4);
            assert_eq!(groups.of(&name("a")), Some(Group::Slow));
            let start = now;
            while groups.of(&name("a")) == Some(Group::Slow) {
                run(&mut groups, &mut now, &[("a", 1e6), ("c", 1e6)], 1);
            }
            seconds.push((now - start).as_secs());
        }
        assert!(seconds[0] <= 6 && seconds[5] >= 60, "{seconds:?}");
        // It leaves for a while, and comes back.
        run(&mut groups, &mut now, &[("a", 1.0), ("c", 1e6)], 4);
        run(&mut groups, &mut now, &[("c", 1e6)], 10);
        assert_eq!(groups.of(&name("a")), None);
        run(&mut groups, &mut now, &[("a", 1e6), ("c", 1e6)], 10);
        assert_eq!(groups.of(&name("a")), Some(Group::Slow), "it is remembered");
    }

    #[test]
    fn a_robot_that_was_moved_is_leaving_for_a_while() {
        let (mut groups, mut now) = (Groups::default(), Instant::now());
        run(&mut groups, &mut now, &[("a", 1.0), ("c", 1e6)], 4);
        let within = Duration::from_secs(5);
        let is_leaving = |robot, now| groups.is_leaving(&name(robot), Group::Main, within, now);
        assert!(is_leaving("a", now) && !is_leaving("c", now));
        assert!(!is_leaving("a", now + within));
    }
}
