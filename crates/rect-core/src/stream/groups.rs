//! Assigns robots to groups: robots with much slower links than the fastest one are in the slow group, so that a laptop
//! on Wi-Fi is not limited by a robot on Bluetooth. The unit is the robot rather than the program, because the programs
//! of a robot share its links.
//!
//! A robot's group follows from its reports, which may be wrong or forged. Therefore a robot that was moved counts in
//! its previous group for only a few seconds, whatever it reports, and a robot that becomes slow repeatedly waits
//! longer each time before it can affect the main group again.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use super::Group;
use crate::name::Name;

/// A robot becomes slow after this time below this share of the fastest rate.
const SLOW_BELOW: f64 = 1.0 / 3.0;
const SLOW_AFTER: Duration = Duration::from_secs(2);
/// A robot returns to the main group after this time above this share.
const MAIN_ABOVE: f64 = 0.6;
const MAIN_AFTER: Duration = Duration::from_secs(4);
/// The maximum number of times that the waiting time of a robot that becomes slow repeatedly is doubled.
const MAX_DOUBLINGS: u32 = 4;
/// How long slowdowns and absent robots are remembered.
const REMEMBERED: Duration = Duration::from_secs(60);

#[derive(Clone, Copy, Debug)]
struct Member {
    group: Group,
    /// Since when its rate has been that of the other group.
    wrong_since: Option<Instant>,
    /// When it was moved to its current group.
    moved: Option<Instant>,
    /// How often it became slow recently.
    slowdowns: u32,
    absent_since: Option<Instant>,
}

/// The groups of all robots.
#[derive(Clone, Debug, Default)]
pub struct Groups {
    members: BTreeMap<Name, Member>,
}

impl Groups {
    /// Returns the group of a robot. `None` if the robot is unknown or absent.
    pub fn of(&self, robot: &Name) -> Option<Group> {
        let member = self.members.get(robot)?;
        member.absent_since.is_none().then_some(member.group)
    }

    /// Handles a report of a robot. If the robot is new, it is assigned to `group`.
    pub fn on_robot(&mut self, robot: &Name, group: Group) {
        let member = Member {
            group,
            wrong_since: None,
            moved: None,
            slowdowns: 0,
            absent_since: None,
        };
        let member = self.members.entry(robot.clone()).or_insert(member);
        member.absent_since = None;
    }

    /// Returns whether a robot was moved out of `group` no longer ago than `within`, so that it may still be subscribed
    /// to it.
    pub fn is_leaving(&self, robot: &Name, group: Group, within: Duration, now: Instant) -> bool {
        let is_recent = |moved: Instant| now.saturating_duration_since(moved) < within;
        let member = self.members.get(robot);
        member.is_some_and(|member| member.group != group && member.moved.is_some_and(is_recent))
    }

    /// Returns the robots of a group.
    pub fn members(&self, group: Group) -> impl Iterator<Item = &Name> {
        let is_member = move |(_, member): &(&Name, &Member)| {
            member.group == group && member.absent_since.is_none()
        };
        self.members.iter().filter(is_member).map(|(name, _)| name)
    }

    /// Updates the groups, given the rate of each robot in bytes per second. Robots that are not in `robots` are
    /// absent. Returns whether the group of any robot has changed.
    pub fn update(&mut self, robots: &BTreeMap<Name, f64>, now: Instant) -> bool {
        let is_recent = |since: Instant| now.saturating_duration_since(since) < REMEMBERED;
        self.members.retain(|name, member| {
            if robots.contains_key(name) {
                return true;
            }
            member.wrong_since = None;
            is_recent(*member.absent_since.get_or_insert(now))
        });
        let best = robots.values().copied().fold(0.0, f64::max);
        let mut has_changed = false;
        for (name, member) in &mut self.members {
            if member.absent_since.is_some() {
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
    /// Returns how long the robot's rate must be high enough before it returns to the main group.
    fn main_after(&self) -> Duration {
        MAIN_AFTER * 2u32.pow(self.slowdowns.saturating_sub(1).min(MAX_DOUBLINGS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> Name {
        Name::new(text).expect("valid name")
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
    fn moves_only_robots_with_much_slower_links_and_only_once() {
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
    fn robots_return_to_the_main_group_when_the_fast_one_leaves() {
        let (mut groups, mut now) = (Groups::default(), Instant::now());
        run(&mut groups, &mut now, &[("a", 29e3), ("c", 5e6)], 10);
        assert_eq!(groups.of(&name("a")), Some(Group::Slow));
        assert_eq!(run(&mut groups, &mut now, &[("a", 29e3)], 10), 1);
        assert_eq!(groups.of(&name("a")), Some(Group::Main));
        assert_eq!(groups.of(&name("c")), None);
    }

    #[test]
    fn robots_between_the_two_thresholds_keep_their_group() {
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
    fn a_robot_that_becomes_slow_repeatedly_waits_longer_each_time() {
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
        // The robot is absent for some time, and returns.
        run(&mut groups, &mut now, &[("a", 1.0), ("c", 1e6)], 4);
        run(&mut groups, &mut now, &[("c", 1e6)], 10);
        assert_eq!(groups.of(&name("a")), None);
        run(&mut groups, &mut now, &[("a", 1e6), ("c", 1e6)], 10);
        assert_eq!(
            groups.of(&name("a")),
            Some(Group::Slow),
            "the slowdowns are remembered"
        );
    }

    #[test]
    fn a_moved_robot_counts_as_leaving_for_some_time() {
        let (mut groups, mut now) = (Groups::default(), Instant::now());
        run(&mut groups, &mut now, &[("a", 1.0), ("c", 1e6)], 4);
        let within = Duration::from_secs(5);
        let is_leaving = |robot, now| groups.is_leaving(&name(robot), Group::Main, within, now);
        assert!(is_leaving("a", now) && !is_leaving("c", now));
        assert!(!is_leaving("a", now + within));
    }
}
