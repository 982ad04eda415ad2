//! The stop of a fleet: latched until somebody releases it, and known to a robot that comes later and to a program that starts again.
//!
//! Each robot retains what it knows on the topic [`TOPIC`]: for each run of a program that has pressed stop, how often it did, and up to
//! which of these it was released. Each takes over what the others know, so that a stop reaches a robot through any other one, and
//! remains when the one that pressed it is switched off. The robot is stopped while one stop is not released. That a robot knows a stop is its
//! confirmation.
use std::{collections::BTreeMap, time::Duration};

use serde::{Deserialize, Serialize};

use crate::{
    message::{
        encoding::Encoding,
        payload::{Cbor, Payload, ToPayload},
    },
    name::{instance::Instance, Name},
    text::display::is_harmful,
};

/// The retained topic on which each robot says which stops it knows.
pub const TOPIC: &str = "stop/state";
/// The pause before a message is published again that could not be.
pub const AGAIN_AFTER: Duration = Duration::from_secs(2);
/// The time within which the routers of other robots know that a program has ended.
pub const MARKED_WITHIN: Duration = Duration::from_secs(3);
/// The maximum number of runs of programs that have pressed stop. Those that were released first are left out.
pub const MAX_RUNS: usize = 64;
/// The maximum number of robots whose confirmations are known.
const MAX_ROBOTS: usize = 256;
/// The maximum length of the name and the reason of a stop, in characters.
const MAX_TEXT: usize = 80;
/// The maximum size of a message, in bytes.
const MAX_BYTES: usize = 32 << 10;

/// The stops that somebody has pressed, in one run of a program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stop {
    /// The run of the program that pressed stop.
    run: u32,
    /// How often it did.
    number: u32,
    /// Up to which of these stops are released.
    #[serde(default)]
    released: u32,
    /// The program that pressed it: `<robot>/<program>`.
    #[serde(default)]
    pub by: String,
    /// Why, in that program's words; empty if it did not say.
    #[serde(default)]
    pub reason: String,
    /// When, in milliseconds since 1970 by the clock of that robot.
    #[serde(default)]
    pub at_ms: u64,
}

/// The stops that a robot knows.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct StopState {
    stops: Vec<Stop>,
}

/// The stop of a fleet, as one program knows it.
#[derive(Debug)]
pub struct FleetStop {
    robot: Name,
    by: String,
    run: u32,
    /// How often this program has pressed stop under that run.
    pressed: u32,
    stops: BTreeMap<u32, Stop>,
    /// The last report of each robot.
    robots: BTreeMap<Name, Report>,
}

/// The stops that a robot knows.
#[derive(Debug)]
struct Report {
    known: StopState,
    /// Whether the program that reported them has ended.
    has_ended: bool,
    is_reachable: bool,
}

/// How far a robot has followed the stop or its release.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Confirmation {
    /// It knows all stops and releases that this program knows.
    Confirmed,
    /// Its program takes part, and has not confirmed.
    Waiting,
    /// The program of the robot that took part has ended.
    Ended,
}

impl Stop {
    /// Returns whether it is not released.
    pub fn is_pressed(&self) -> bool {
        self.number > self.released
    }

    /// Returns the stop in words: `stopped by laptop/page: smoke`.
    pub fn in_words(&self) -> String {
        match self.reason.as_str() {
            "" => format!("stopped by {}", self.by),
            reason => format!("stopped by {}: {reason}", self.by),
        }
    }

    fn checked(self) -> Option<Self> {
        (self.number > 0 && self.released <= self.number).then(|| Self {
            by: short(&self.by),
            reason: short(&self.reason),
            ..self
        })
    }

    /// Takes over what another robot knows. Returns whether that is something new.
    fn merge(&mut self, other: &Self) -> bool {
        let before = (self.number, self.released);
        if other.number > self.number {
            let released = self.released;
            *self = Self {
                released,
                ..other.clone()
            };
        }
        self.released = self.released.max(other.released);
        (self.number, self.released) != before
    }
}

fn short(text: &str) -> String {
    let printable = text.chars().filter(|c| !is_harmful(*c));
    printable.take(MAX_TEXT).collect()
}

impl FleetStop {
    /// Creates the knowledge of a run of a program, which knows of no stop.
    pub fn new(robot: Name, program: Option<&Name>, instance: Instance) -> Self {
        let by = match program {
            Some(program) => format!("{robot}/{program}"),
            None => robot.to_string(),
        };
        Self {
            robot,
            by,
            run: instance.0,
            pressed: 0,
            stops: BTreeMap::new(),
            robots: BTreeMap::new(),
        }
    }

    /// Stops the fleet. Then publish the [`message`](Self::message).
    pub fn press(&mut self, reason: &str, now_ms: u64) {
        // Somebody may have used the number of this run; a stop must not be taken for one that was released.
        let is_used = |run| {
            let known = self.stops.get(&run);
            known.map_or(0, |stop| stop.number) != self.pressed
        };
        if is_used(self.run) || self.pressed == u32::MAX {
            self.pressed = 0;
            while self.stops.contains_key(&self.run) {
                self.run = self.run.wrapping_add(1);
            }
        }
        self.pressed += 1;
        let released = self.stops.get(&self.run).map_or(0, |stop| stop.released);
        let stop = Stop {
            run: self.run,
            number: self.pressed,
            released,
            by: self.by.clone(),
            reason: short(reason),
            at_ms: now_ms,
        };
        self.stops.insert(self.run, stop);
        self.limit();
    }

    /// Releases all stops that are known here. Then publish the [`message`](Self::message). Returns whether there was one.
    pub fn release(&mut self) -> bool {
        let was_stopped = self.is_stopped();
        for stop in self.stops.values_mut() {
            stop.released = stop.number;
        }
        was_stopped
    }

    /// Handles what a robot knows. `has_ended`: its program has ended that said so. Returns whether this program learned something new,
    /// so that the [`message`](Self::message) is to be published.
    ///
    /// # Errors
    /// Returns why the message is not one of a robot that takes part. It changes nothing.
    pub fn on_message(
        &mut self,
        robot: &Name,
        payload: &Payload,
        has_ended: bool,
    ) -> Result<bool, String> {
        if payload.bytes.len() > MAX_BYTES {
            return Err(format!(
                "{} bytes, and at most {MAX_BYTES} are allowed",
                payload.bytes.len()
            ));
        }
        let known: StopState = payload.value().map_err(|error| error.to_string())?;
        if known.stops.len() > MAX_RUNS {
            return Err(format!("more than {MAX_RUNS} programs"));
        }
        let stops: Vec<_> = known.stops.into_iter().filter_map(Stop::checked).collect();
        let mut is_new = false;
        for stop in &stops {
            let is_full = self.stops.len() >= MAX_RUNS;
            match self.stops.get_mut(&stop.run) {
                Some(known) => is_new |= known.merge(stop),
                // A release that is known nowhere needs no memory.
                None if is_full && !stop.is_pressed() => {}
                None => {
                    self.stops.insert(stop.run, stop.clone());
                    is_new = true;
                }
            }
        }
        self.limit();
        if self.robots.len() < MAX_ROBOTS || self.robots.contains_key(robot) {
            let before = self.robots.get(robot);
            let report = Report {
                known: StopState { stops },
                has_ended,
                // A message of a robot that cannot be reached is a copy that another one has.
                is_reachable: before.is_none_or(|before| before.is_reachable),
            };
            self.robots.insert(robot.clone(), report);
        }
        // Another program of this robot may have published something older.
        let is_behind =
            *robot == self.robot && self.confirmation(robot) != Some(Confirmation::Confirmed);
        Ok(is_new || is_behind)
    }

    /// Handles that a robot cannot be reached any more.
    pub fn on_gone(&mut self, robot: &Name) {
        if let Some(report) = self.robots.get_mut(robot) {
            report.is_reachable = false;
        }
    }

    /// Handles that a robot can be reached again. It publishes again only if it learns of something.
    pub fn on_returned(&mut self, robot: &Name) {
        if let Some(report) = self.robots.get_mut(robot) {
            report.is_reachable = true;
        }
    }

    /// Returns the message with what this program knows, which is retained.
    pub fn message(&self) -> Payload {
        let stops = self.stops.values().cloned().collect();
        // Numbers and texts can always be serialized.
        let payload = Cbor(StopState { stops }).to_payload();
        payload.unwrap_or_else(|_| Payload::new("", Encoding::CBOR))
    }

    /// Returns whether the fleet is stopped.
    pub fn is_stopped(&self) -> bool {
        self.stops.values().any(Stop::is_pressed)
    }

    /// Returns the stops that are not released, the latest first.
    pub fn pressed(&self) -> Vec<Stop> {
        let pressed = self.stops.values().filter(|stop| stop.is_pressed());
        let mut pressed: Vec<_> = pressed.cloned().collect();
        pressed.sort_by_key(|stop| std::cmp::Reverse(stop.at_ms));
        pressed
    }

    /// Returns the latest of these stops in words; `None` if the fleet is not stopped.
    pub fn reason(&self) -> Option<String> {
        self.pressed().first().map(Stop::in_words)
    }

    /// Returns whether a robot has confirmed; `None` if it does not take part, or cannot be reached.
    pub fn confirmation(&self, robot: &Name) -> Option<Confirmation> {
        let report = self.robots.get(robot).filter(|one| one.is_reachable)?;
        let knows = |stop: &Stop| {
            let of_robot = report
                .known
                .stops
                .iter()
                .find(|other| other.run == stop.run);
            match of_robot {
                Some(other) => other.number >= stop.number && other.released >= stop.released,
                // It may have left out what was released long ago.
                None => !stop.is_pressed(),
            }
        };
        Some(match self.stops.values().all(knows) {
            _ if report.has_ended => Confirmation::Ended,
            true => Confirmation::Confirmed,
            false => Confirmation::Waiting,
        })
    }

    /// Leaves out the runs that were released first, if there are too many.
    fn limit(&mut self) {
        while self.stops.len() > MAX_RUNS {
            let released = self.stops.values().filter(|stop| !stop.is_pressed());
            let oldest = released.min_by_key(|stop| stop.at_ms);
            let Some(run) = oldest.or(self.stops.values().next()).map(|stop| stop.run) else {
                return;
            };
            self.stops.remove(&run);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::simulation::Random;

    fn name(robot: &str) -> Name {
        Name::new(robot).expect("valid")
    }

    fn fleet<const N: usize>(robots: [&str; N]) -> [FleetStop; N] {
        let mut run = 0;
        robots.map(|robot| {
            run += 1;
            FleetStop::new(name(robot), None, Instance(run))
        })
    }

    /// Passes on what one knows. Returns whether that was new.
    fn tell(from: &FleetStop, to: &mut FleetStop) -> bool {
        let learned = to.on_message(&from.robot, &from.message(), false);
        learned.expect("a message")
    }

    #[test]
    fn a_stop_reaches_a_robot_through_another_one_and_is_confirmed() {
        let [mut laptop, mut one, mut two] = fleet(["laptop", "one", "two"]);
        laptop.press("smoke", 5);
        assert!(tell(&laptop, &mut one) && one.is_stopped());
        assert!(!tell(&laptop, &mut one));
        assert_eq!(one.pressed()[0].in_words(), "stopped by laptop: smoke");
        // The laptop is switched off, and the other robot comes.
        assert!(tell(&one, &mut two) && two.is_stopped());
        assert_eq!(laptop.confirmation(&two.robot), None);
        assert!(!tell(&two, &mut laptop));
        assert_eq!(
            laptop.confirmation(&two.robot),
            Some(Confirmation::Confirmed)
        );
        // Somebody else releases it, and the laptop does not stop it again.
        assert!(two.release() && !two.is_stopped() && !two.release());
        assert!(!tell(&laptop, &mut two) && !two.is_stopped());
        assert_eq!(two.confirmation(&laptop.robot), Some(Confirmation::Waiting));
        assert!(tell(&two, &mut laptop) && !laptop.is_stopped());
    }

    #[test]
    fn a_robot_that_returns_has_confirmed_what_it_had_confirmed() {
        let [mut laptop, mut one] = fleet(["laptop", "one"]);
        laptop.press("smoke", 5);
        tell(&laptop, &mut one);
        tell(&one, &mut laptop);
        laptop.on_gone(&one.robot);
        assert_eq!(laptop.confirmation(&one.robot), None);
        laptop.on_returned(&one.robot);
        let confirmed = Some(Confirmation::Confirmed);
        assert_eq!(laptop.confirmation(&one.robot), confirmed);
        laptop.on_gone(&one.robot);
        laptop.press("", 6);
        laptop.on_returned(&one.robot);
        assert_eq!(laptop.confirmation(&one.robot), Some(Confirmation::Waiting));
    }

    #[test]
    fn a_release_does_not_concern_a_stop_that_it_did_not_know() {
        let [mut laptop, mut base, mut robot] = fleet(["laptop", "base", "robot"]);
        base.press("", 1);
        laptop.press("", 2);
        base.release();
        tell(&base, &mut robot);
        tell(&laptop, &mut robot);
        assert!(robot.is_stopped());
        // A second stop of the same program, too.
        tell(&laptop, &mut base);
        base.release();
        laptop.press("", 3);
        for from in [&base, &laptop, &base] {
            tell(from, &mut robot);
        }
        assert!(robot.is_stopped() && robot.pressed().len() == 1);
    }

    #[test]
    fn a_stop_cannot_be_released_before_it_is_pressed() {
        let [mut laptop, mut robot] = fleet(["laptop", "robot"]);
        let forged = StopState {
            stops: vec![Stop {
                run: 1,
                number: u32::MAX,
                released: u32::MAX,
                by: String::new(),
                reason: String::new(),
                at_ms: 0,
            }],
        };
        let forged = Cbor(forged).to_payload().expect("valid");
        for program in [&mut laptop, &mut robot] {
            program
                .on_message(&name("evil"), &forged, false)
                .expect("read");
        }
        for _ in 0..3 {
            laptop.press("", 1);
            tell(&laptop, &mut robot);
            assert!(laptop.is_stopped() && robot.is_stopped());
            robot.release();
            tell(&robot, &mut laptop);
            assert!(!laptop.is_stopped());
        }
    }

    #[test]
    fn messages_of_peers_are_read_with_limits() {
        let [mut robot] = fleet(["robot"]);
        let many = |count: u32, released: u32| {
            let stops = (0..count).map(|run| Stop {
                run: run + 1000 * released,
                number: 1,
                released,
                by: "x".repeat(200) + "\u{1b}",
                reason: String::new(),
                at_ms: run.into(),
            });
            let stops = stops.collect();
            Cbor(StopState { stops }).to_payload().expect("valid")
        };
        let evil = name("evil");
        for wrong in [
            many(65, 0),
            Payload::new(vec![0xFF; 10], Encoding::CBOR),
            Payload::new(vec![b' '; 40_000], Encoding::JSON),
        ] {
            assert!(robot.on_message(&evil, &wrong, false).is_err());
        }
        assert!(!robot.is_stopped());
        robot.on_message(&evil, &many(64, 0), false).expect("read");
        assert_eq!(
            (robot.pressed().len(), robot.pressed()[0].by.len()),
            (64, 80)
        );
        // A stop that is released makes room for a stop.
        robot.release();
        robot.press("", 1000);
        assert!(robot.is_stopped() && robot.stops.len() == 64);
        for number in 0..300 {
            let known = robot.on_message(&name(&format!("r{number}")), &many(1, 0), false);
            known.expect("read");
        }
        assert_eq!(robot.robots.len(), MAX_ROBOTS);
    }

    #[test]
    fn all_agree_whatever_the_order_in_1000_runs() {
        for seed in 0..1000_u64 {
            let mut random = Random(seed);
            let mut random = |limit: u64| random.next() % limit;
            let mut robots = fleet(["a", "b", "c", "d", "e"]);
            // The stops that nobody who knew them has released.
            let mut open: Vec<(u32, u32)> = Vec::new();
            for step in 0..40 {
                let [at, to] = [0, 1].map(|_| usize::try_from(random(5)).expect("small"));
                match random(6) {
                    0 => {
                        robots[at].press("", step);
                        open.push((robots[at].run, robots[at].pressed));
                    }
                    1 => {
                        let known = robots[at].pressed();
                        robots[at].release();
                        open.retain(|(run, number)| {
                            !known
                                .iter()
                                .any(|stop| stop.run == *run && stop.number >= *number)
                        });
                    }
                    // Only some messages arrive, and old ones as well as new ones.
                    _ => {
                        let message = robots[at].message();
                        let sender = robots[at].robot.clone();
                        robots[to]
                            .on_message(&sender, &message, false)
                            .expect("read");
                    }
                }
            }
            for _ in 0..5 {
                for (at, to) in (0..5).flat_map(|at| (0..5).map(move |to| (at, to))) {
                    let (message, sender) = (robots[at].message(), robots[at].robot.clone());
                    robots[to]
                        .on_message(&sender, &message, false)
                        .expect("read");
                }
            }
            for robot in &robots {
                assert_eq!(robot.is_stopped(), !open.is_empty(), "seed {seed}");
                assert_eq!(robot.stops, robots[0].stops, "seed {seed}");
                let confirmed = robots
                    .iter()
                    .all(|other| robot.confirmation(&other.robot) == Some(Confirmation::Confirmed));
                assert!(confirmed, "seed {seed}");
            }
        }
    }
}
