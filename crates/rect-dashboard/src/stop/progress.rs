//! Keeps how far the robots have followed a stop of the fleet; logic without I/O.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use rect::{Confirmation, Event, Name, Stop};

use crate::protocol::{PressedStop, StopState, StoppedRobot};

/// When a robot that takes part and has not confirmed counts as silent.
const SILENT_AFTER: Duration = Duration::from_secs(2);

const NOT_SENT: &str = "Not sent: the router of this computer cannot be reached. The stop is sent as soon as it is back";
const ROUTER_LOST: &str =
    "The router of this computer cannot be reached. Which robots have the stop is not known";

/// How far the robots have followed.
pub struct Progress {
    own: Name,
    /// The robots that were reachable once, apart from this one, and whether they are.
    reachable: BTreeMap<Name, bool>,
    is_connected: bool,
    /// When somebody pressed the button of this program, until the stop is known.
    pressing: Option<Instant>,
    /// The stops that nobody has released, the latest first.
    pressed: Vec<Stop>,
    /// When the latest one was pressed, if it was here.
    begun: Option<Instant>,
    /// Whether the router of this computer has the stops.
    is_sent: bool,
    /// Why the router did not take the stop.
    problem: Option<String>,
    robots: BTreeMap<Name, Following>,
}

/// How far one robot has followed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Following {
    /// It has confirmed, so long after the button of this program was pressed.
    Confirmed(Option<Duration>),
    /// It takes part, and has not confirmed since then.
    Waiting(Instant),
    /// Its program that took part has ended.
    Ended,
    /// None of its programs takes part.
    NoPart,
    Unreachable,
}

impl Progress {
    /// Creates the progress of the fleet of the robot `own`, which is not stopped.
    pub fn new(own: Name) -> Self {
        Self {
            own,
            reachable: BTreeMap::new(),
            is_connected: true,
            pressing: None,
            pressed: Vec::new(),
            begun: None,
            is_sent: false,
            problem: None,
            robots: BTreeMap::new(),
        }
    }

    /// Handles that somebody presses the button of this program. [`update`](Self::update) follows once the stop is known.
    pub fn on_press(&mut self, now: Instant) {
        self.pressing = Some(now);
        self.problem = None;
    }

    /// Handles the result of pressing: `problem` is why no router keeps the stop.
    pub fn on_pressed(&mut self, problem: Option<String>) {
        self.problem = problem;
    }

    /// Handles a change of the fleet.
    pub fn on_event(&mut self, event: &Event) {
        match event {
            Event::PeerUp { robot } => drop(self.reachable.insert(robot.clone(), true)),
            Event::PeerDown { robot } => drop(self.reachable.insert(robot.clone(), false)),
            Event::RouterUp => self.is_connected = true,
            Event::RouterDown => self.is_connected = false,
            _ => {}
        }
    }

    /// Takes over the stops that are known, and what each robot has confirmed of them.
    pub fn update(
        &mut self,
        pressed: Vec<Stop>,
        confirmation: impl Fn(&Name) -> Option<Confirmation>,
        now: Instant,
    ) {
        let is_new = pressed.iter().any(|stop| !self.pressed.contains(stop));
        if is_new {
            self.robots.clear();
            self.begun = self.pressing.take();
        }
        self.pressed = pressed;
        // Its router sends the stop back to this program as well.
        self.is_sent = confirmation(&self.own) == Some(Confirmation::Confirmed);
        if self.is_sent || self.pressed.is_empty() {
            self.problem = None;
        }
        for (robot, is_reachable) in &self.reachable {
            let before = self.robots.get(robot).copied();
            let following = match confirmation(robot) {
                _ if !is_reachable => Following::Unreachable,
                None => Following::NoPart,
                Some(Confirmation::Ended) => Following::Ended,
                Some(Confirmation::Waiting) => match before {
                    Some(Following::Waiting(since)) => Following::Waiting(since),
                    _ => Following::Waiting(now),
                },
                Some(Confirmation::Confirmed) => match before {
                    Some(Following::Confirmed(after)) => Following::Confirmed(after),
                    // One that was confirmed before, and was out of reach.
                    Some(Following::Unreachable) => Following::Confirmed(None),
                    _ => Following::Confirmed(self.begun.map(|begun| now - begun)),
                },
            };
            self.robots.insert(robot.clone(), following);
        }
    }

    /// Returns what browsers show; `None` if the fleet is not stopped.
    pub fn state(&self, now: Instant) -> Option<StopState> {
        if self.pressed.is_empty() {
            return None;
        }
        let pressed = self.pressed.iter().map(|stop| PressedStop {
            by: stop.by.clone(),
            reason: stop.reason.clone(),
            at_ms: stop.at_ms,
        });
        let problem = match (self.is_connected, self.is_sent) {
            (false, false) => Some(NOT_SENT.to_owned()),
            (false, true) => Some(ROUTER_LOST.to_owned()),
            (true, _) => (self.problem.as_ref()).map(|problem| format!("Not sent: {problem}")),
        };
        let robots = self
            .robots
            .iter()
            .map(|(robot, following)| stopped(robot, *following, now));
        Some(StopState {
            pressed: pressed.collect(),
            is_sent: self.is_sent,
            problem,
            robots: robots.collect(),
        })
    }
}

fn stopped(robot: &Name, following: Following, now: Instant) -> StoppedRobot {
    let (outcome, after) = match following {
        Following::Confirmed(after) => ("confirmed", after),
        Following::Waiting(since) if now - since < SILENT_AFTER => ("waiting", None),
        Following::Waiting(_) => ("silent", None),
        Following::Ended => ("ended", None),
        Following::NoPart => ("no_part", None),
        Following::Unreachable => ("unreachable", None),
    };
    StoppedRobot {
        robot: robot.to_string(),
        outcome,
        ms: after.map(|after| (after.as_secs_f64() * 10_000.0).round() / 10.0),
    }
}

#[cfg(test)]
mod tests {
    use rect_core::{name::instance::Instance, stop::FleetStop};

    use super::*;

    fn name(robot: &str) -> Name {
        Name::new(robot).expect("a name")
    }

    /// The progress of the fleet of a laptop, and the time.
    struct Fleet {
        progress: Progress,
        stop: FleetStop,
        robots: BTreeMap<Name, Confirmation>,
        now: Instant,
    }

    impl Fleet {
        fn new<const N: usize>(robots: [&str; N]) -> Self {
            let mut progress = Progress::new(name("laptop"));
            for robot in robots {
                progress.on_event(&Event::PeerUp { robot: name(robot) });
            }
            Self {
                progress,
                stop: FleetStop::new(name("laptop"), None, Instance(1)),
                robots: BTreeMap::new(),
                now: Instant::now(),
            }
        }

        fn after(&mut self, ms: u64, confirmations: &[(&str, Confirmation)]) -> String {
            self.now += Duration::from_millis(ms);
            for (robot, confirmation) in confirmations {
                self.robots.insert(name(robot), *confirmation);
            }
            let confirmation = |robot: &Name| self.robots.get(robot).copied();
            (self.progress).update(self.stop.pressed(), confirmation, self.now);
            let Some(state) = self.progress.state(self.now) else {
                return "not stopped".to_owned();
            };
            let robots = state.robots.iter().map(|stopped| match stopped.ms {
                Some(ms) => format!("{} {} {ms}", stopped.robot, stopped.outcome),
                None => format!("{} {}", stopped.robot, stopped.outcome),
            });
            robots.collect::<Vec<_>>().join(", ")
        }

        fn problem(&self) -> Option<String> {
            self.progress
                .state(self.now)
                .and_then(|state| state.problem)
        }
    }

    use Confirmation::{Confirmed, Ended, Waiting};

    #[test]
    fn each_robot_has_its_own_outcome() {
        let mut fleet = Fleet::new(["a", "b", "c", "d", "e"]);
        assert_eq!(fleet.after(0, &[("a", Confirmed)]), "not stopped");
        let gone = Event::PeerDown { robot: name("e") };
        fleet.progress.on_event(&gone);
        fleet.progress.on_press(fleet.now);
        fleet.stop.press("smoke", 5);
        let first = fleet.after(0, &[("a", Waiting), ("b", Waiting), ("c", Ended)]);
        assert_eq!(
            first,
            "a waiting, b waiting, c ended, d no_part, e unreachable"
        );
        assert!(fleet
            .after(30, &[("a", Confirmed)])
            .starts_with("a confirmed 30,"));
        // A confirmation keeps its time, and one that is late is silent until it comes.
        let late = fleet.after(2000, &[]);
        assert!(late.starts_with("a confirmed 30, b silent"), "{late}");
        let returned = Event::PeerUp { robot: name("e") };
        fleet.progress.on_event(&returned);
        let last = fleet.after(0, &[("b", Confirmed), ("e", Confirmed)]);
        assert!(last.contains("b confirmed 2030") && last.ends_with("e confirmed"));
        fleet.stop.release();
        assert_eq!(fleet.after(0, &[]), "not stopped");
    }

    #[test]
    fn the_time_until_a_confirmation_is_known_only_of_stops_that_were_pressed_here() {
        let mut fleet = Fleet::new(["a"]);
        fleet.stop.press("", 5);
        assert_eq!(fleet.after(10, &[("a", Confirmed)]), "a confirmed");
        fleet.progress.on_press(fleet.now);
        fleet.stop.press("", 6);
        assert_eq!(fleet.after(20, &[]), "a confirmed 20");
    }

    #[test]
    fn a_stop_without_the_router_is_not_sent_until_the_router_has_it() {
        let mut fleet = Fleet::new(["a"]);
        fleet.progress.on_event(&Event::RouterDown);
        fleet.progress.on_press(fleet.now);
        fleet.stop.press("", 5);
        fleet.after(0, &[("laptop", Waiting)]);
        assert!(fleet
            .problem()
            .is_some_and(|text| text.starts_with("Not sent: the router")));
        fleet
            .progress
            .on_pressed(Some("nobody keeps it".to_owned()));
        fleet.progress.on_event(&Event::RouterUp);
        fleet.after(0, &[]);
        assert_eq!(
            fleet.problem().as_deref(),
            Some("Not sent: nobody keeps it")
        );
        fleet.after(0, &[("laptop", Confirmed)]);
        assert_eq!(fleet.problem(), None);
        fleet.progress.on_event(&Event::RouterDown);
        assert_eq!(fleet.problem().as_deref(), Some(ROUTER_LOST));
    }
}
