//! Warns of a name that nobody has: probably it is misspelled, or its owner starts late.
use std::{
    collections::{BTreeSet, HashSet},
    time::{Duration, Instant},
};

use super::{names::reachable_robots, peers::PeersQuery};
use crate::{
    driver::{Action, Driver, Event, Get, Id, Reaction, Step, Target},
    name::{
        key::KeySpace,
        topic::{Pattern, RobotTopic},
        Name,
    },
    text::names::in_words,
};

/// How long a name may be unknown before the warning: robots and programs are often started at the same time.
pub const CHECKED_AFTER: Duration = Duration::from_millis(2500);
/// The timeout of the question for the streams of a robot.
const TIMEOUT: Duration = Duration::from_secs(5);
/// The largest number of streams of a robot that are read.
const MAX_STREAMS: usize = 1000;
/// The largest number of names of a program that are checked.
const MAX_CHECKED: usize = 1000;
const STREAMS: Id = Id(1);

/// A name that a program uses.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Used {
    /// The robot of a pattern, which a program subscribes to.
    Pattern(Pattern),
    /// A robot that a program waits for.
    Robot(Name),
    /// A stream that a program watches.
    Stream(RobotTopic),
}

impl Used {
    /// Returns the robot that is meant; `None` if any robot is.
    fn robot(&self) -> Option<&Name> {
        match self {
            Self::Pattern(pattern) => pattern.robot(),
            Self::Robot(robot) => Some(robot),
            Self::Stream(stream) => Some(&stream.robot),
        }
    }
}

/// The names that one program has used.
#[derive(Debug, Default)]
pub struct UsedNames {
    checked: HashSet<Used>,
    warned_topics: HashSet<String>,
}

impl UsedNames {
    /// Returns the check of a name, unless the program has used it before, or it is its own.
    pub fn check(&mut self, place: &KeySpace, used: Used, now: Instant) -> Option<NameCheck> {
        let robot = used.robot()?.clone();
        let is_new = self.checked.len() < MAX_CHECKED && !self.checked.contains(&used);
        if !is_new || robot == place.robot {
            return None;
        }
        self.checked.insert(used.clone());
        Some(NameCheck {
            place: place.clone(),
            robot,
            used,
            due: now + CHECKED_AFTER,
            peers: PeersQuery::new(place.clone()),
            state: State::Peers,
            streams: BTreeSet::new(),
        })
    }

    /// Returns a warning of a topic or pattern that is probably misspelled, unless the program has used it before.
    pub fn on_topic(&mut self, topic: &str) -> Option<String> {
        let is_suspicious = topic.contains(char::is_whitespace);
        if !is_suspicious || self.warned_topics.len() >= MAX_CHECKED {
            return None;
        }
        self.warned_topics.insert(topic.to_owned()).then(|| {
            format!(
                "the topic {topic:?} contains a space, and only programs that write it in the same way receive it; \
                 `rect topic list` lists the topics of all robots"
            )
        })
    }
}

/// Checks whether somebody has a name. Delivers the text of a warning if nobody has.
#[derive(Debug)]
pub struct NameCheck {
    place: KeySpace,
    robot: Name,
    used: Used,
    due: Instant,
    peers: PeersQuery,
    state: State,
    streams: BTreeSet<String>,
}

#[derive(Debug)]
enum State {
    /// The robots are asked for.
    Peers,
    /// The streams of the robot are asked for.
    Streams {
        is_asked: bool,
    },
    Warning(String),
    Finished,
}

impl NameCheck {
    fn on_peers(&self, reachable: &[Name]) -> State {
        if reachable.contains(&self.robot) {
            return match self.used {
                Used::Stream(_) => State::Streams { is_asked: false },
                _ => State::Finished,
            };
        }
        // Otherwise the routers do not know the names of their robots.
        let names_are_known = self.peers.is_own_known() || !reachable.is_empty();
        if !names_are_known {
            return State::Finished;
        }
        let robot = &self.robot;
        let names = reachable_robots(robot, reachable);
        let mut text = format!("no robot called {robot} is reachable yet; {names}");
        let topic = match &self.used {
            Used::Pattern(pattern) if !pattern.topic().contains('*') => Some(pattern.topic()),
            _ => None,
        };
        if let Some(topic) = topic {
            text.push_str(&format!(
                ". The pattern {robot}/{topic} means the robot {robot}; for the topic {robot}/{topic} of every robot, use \
                 */{robot}/{topic}"
            ));
        }
        State::Warning(text)
    }

    fn on_streams(&self, topic: &str) -> State {
        if self.streams.contains(topic) {
            return State::Finished;
        }
        let robot = &self.robot;
        let streams = in_words(
            "its streams",
            topic,
            self.streams.iter().map(String::as_str),
        );
        State::Warning(format!("{robot} has no stream {topic} yet; {streams}"))
    }

    fn stream_keys(&self) -> String {
        self.place.own(Some(&self.robot), "stream/**")
    }
}

impl Driver for NameCheck {
    type Item = String;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<String> {
        match (&self.state, event) {
            (_, Event::Closed) => self.state = State::Finished,
            (State::Peers, event) => {
                let polls = self.peers.on_event(now, event).polls;
                return if polls {
                    Reaction::POLL
                } else {
                    Reaction::NONE
                };
            }
            (
                State::Streams { .. },
                Event::Reply {
                    reply: Ok(sample), ..
                },
            ) => {
                let start = self.stream_keys();
                let topic = sample.key.strip_prefix(start.trim_end_matches("**"));
                if self.streams.len() < MAX_STREAMS {
                    self.streams.extend(topic.map(str::to_owned));
                }
                return Reaction::NONE;
            }
            (State::Streams { .. }, Event::Ended { .. }) => {
                if let Used::Stream(stream) = &self.used {
                    self.state = self.on_streams(stream.topic.as_str());
                }
            }
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<String, ()> {
        if now < self.due && !matches!(self.state, State::Finished) {
            return Step::Wait(Some(self.due));
        }
        match &mut self.state {
            State::Peers => match self.peers.poll(now) {
                Step::Act(action) => Step::Act(action),
                Step::Wait(at) => Step::Wait(at),
                Step::Deliver(never) => match never {},
                Step::Finished(reachable) => {
                    self.state = self.on_peers(&reachable);
                    self.poll(now)
                }
            },
            State::Streams { is_asked: true } => Step::Wait(None),
            State::Streams { is_asked } => {
                *is_asked = true;
                let get = Get {
                    target: Target::All,
                    ..Get::new(self.stream_keys(), TIMEOUT)
                };
                Step::Act(Action::Get { id: STREAMS, get })
            }
            State::Warning(text) => {
                let text = std::mem::take(text);
                self.state = State::Finished;
                Step::Deliver(text)
            }
            State::Finished => Step::Finished(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        driver::Sample,
        message::{encoding::Encoding, payload::Payload},
        name::topic::Topic,
    };

    fn place() -> KeySpace {
        KeySpace {
            fleet: Name::new("rect").unwrap(),
            robot: Name::new("laptop").unwrap(),
        }
    }

    /// Runs a check among these robots, and returns its warning and the time that it took.
    fn checked(used: Used, robots: &[&str], streams: &[&str]) -> (Option<String>, Duration) {
        let start = Instant::now();
        let mut now = start;
        let Some(mut check) = UsedNames::default().check(&place(), used, now) else {
            return (None, Duration::ZERO);
        };
        let mut warning = None;
        loop {
            match check.poll(now) {
                Step::Wait(Some(at)) => now = at,
                Step::Wait(None) => panic!("it waits for nothing"),
                Step::Deliver(text) => warning = Some(text),
                Step::Finished(()) => return (warning, now - start),
                Step::Act(Action::Get { id, get }) => {
                    let keys: Vec<_> = if id == STREAMS {
                        assert_eq!(get.selector, "rect/wombat-2/@rect/stream/**");
                        let key = |name| format!("rect/wombat-2/@rect/stream/{name}");
                        streams.iter().map(key).collect()
                    } else {
                        let key = |name| format!("rect/{name}/@rect/alive/1");
                        robots.iter().map(key).collect()
                    };
                    for key in keys {
                        let payload = Payload::new("", Encoding::BYTES);
                        let (attachment, is_deleted) = (None, false);
                        let reply = Ok(Sample {
                            key,
                            payload,
                            attachment,
                            is_deleted,
                            priority: Sample::PRIORITY,
                        });
                        let _ = check.on_event(now, Event::Reply { id, reply });
                    }
                    let _ = check.on_event(now, Event::Ended { id });
                }
                Step::Act(action) => panic!("{action:?}"),
            }
        }
    }

    fn pattern(text: &str) -> Used {
        Used::Pattern(Pattern::new(text).unwrap())
    }

    fn stream(robot: &str, topic: &str) -> Used {
        Used::Stream(RobotTopic {
            robot: Name::new(robot).unwrap(),
            topic: Topic::new(topic).unwrap(),
        })
    }

    #[test]
    fn a_warning_of_a_name_that_nobody_has_comes_within_three_seconds() {
        let robots = ["digger", "laptop", "wombat-2"];
        let reachable = "(reachable robots: digger, wombat-2)";
        let warning = |used| {
            let (warning, took) = checked(used, &robots, &["camera", "rear"]);
            assert!(took < Duration::from_secs(3), "{took:?}");
            warning
        };
        assert_eq!(
            warning(pattern("arm/angle")).as_deref(),
            Some(
                "no robot called arm is reachable yet; reachable robots: digger, wombat-2. The pattern arm/angle means the \
                 robot arm; for the topic arm/angle of every robot, use */arm/angle"
            )
        );
        assert_eq!(
            warning(Used::Robot(Name::new("diger").unwrap())),
            Some(format!(
                "no robot called diger is reachable yet; did you mean digger? {reachable}"
            ))
        );
        // Another robot, not a misspelling.
        assert_eq!(
            warning(Used::Robot(Name::new("wombat-3").unwrap())).as_deref(),
            Some("no robot called wombat-3 is reachable yet; reachable robots: digger, wombat-2")
        );
        assert_eq!(
            warning(stream("wombat-2", "camra")).as_deref(),
            Some("wombat-2 has no stream camra yet; did you mean camera? (its streams: camera, rear)")
        );
        assert!(warning(stream("wombat", "camera"))
            .is_some_and(|text| text.starts_with("no robot called wombat ")));
    }

    #[test]
    fn a_name_that_somebody_has_is_no_reason_for_a_warning() {
        let robots = ["digger", "laptop", "wombat-2"];
        // A network whose routers do not know the names of their robots.
        assert_eq!(checked(pattern("arm/angle"), &[], &[]).0, None);
        for used in [
            pattern("wombat-2/arm/*"),
            pattern("*/arm/angle"),
            pattern("laptop/angle"),
            stream("wombat-2", "camera"),
        ] {
            assert_eq!(
                checked(used.clone(), &robots, &["camera"]).0,
                None,
                "{used:?}"
            );
        }
    }

    #[test]
    fn each_name_is_checked_once_and_a_long_list_is_shortened() {
        let mut names = UsedNames::default();
        assert!(names
            .check(&place(), pattern("arm/angle"), Instant::now())
            .is_some());
        assert!(names
            .check(&place(), pattern("arm/angle"), Instant::now())
            .is_none());
        let robots: Vec<_> = (0..30).map(|n| format!("robot-{n}")).collect();
        let robots: Vec<_> = robots
            .iter()
            .map(String::as_str)
            .chain(["laptop"])
            .collect();
        let text = checked(pattern("arm/angle"), &robots, &[])
            .0
            .expect("a warning");
        assert!(text.contains(" and 10 more"), "{text}");
    }

    #[test]
    fn a_topic_with_a_space_is_suspicious() {
        let mut names = UsedNames::default();
        assert!(names.on_topic("arm angle").is_some());
        assert_eq!(names.on_topic("arm angle"), None);
        assert_eq!(names.on_topic("arm/angle"), None);
    }
}
