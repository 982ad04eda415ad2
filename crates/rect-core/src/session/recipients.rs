//! Drives the observation of the robots that are reachable, for messages to one of them.
use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    time::{Duration, Instant},
};

use super::peers::{tokens, TIMEOUT};
use crate::{
    driver::{
        ended_tokens::EndedTokens,
        question::{Next, Question},
        Action, Declaration, Driver, Event, Get, Id, Reaction, Step,
    },
    name::{key::KeySpace, Name},
};

/// How often a question is asked at once; see [`PeersQuery`](super::peers::PeersQuery).
const QUESTIONS: usize = 2;
/// The longest wait of a message for the answer of a router that is slow. It is then sent in any case.
const LONGEST_WAIT: Duration = Duration::from_secs(1);
/// The largest number of tokens that are kept. If there are more, every robot counts as reachable.
const MAX_TOKENS: usize = 4096;
/// The largest number of robots that are known to be missing.
const MAX_MISSING: usize = 4096;
const TOKENS: Id = Id(0);
const QUERY: Id = Id(1);

/// Whether messages to a robot can arrive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reachability {
    /// The robot is reachable, or it is not known which robots are: routers without RECT do not know the names of robots.
    Reachable,
    /// It is not reachable. These are.
    Unreachable(Vec<Name>),
    /// It is not known yet: wait for the next item of the driver, and ask again.
    Unsure,
}

/// Observes which robots are reachable. Delivers an item when an answer that was [`Unsure`](Reachability::Unsure) may be known.
///
/// A robot without a token is asked for before it counts as missing, since its token may arrive after its messages. This
/// is between the program and its own router. From then on, it is missing until it has a token.
#[derive(Debug)]
pub struct Recipients {
    place: KeySpace,
    tokens: HashSet<String>,
    /// The robots that have tokens, and how many.
    reachable: BTreeMap<Name, usize>,
    missing: BTreeSet<Name>,
    /// The robots that are asked for.
    sought: BTreeSet<Name>,
    question: Question,
    ended: EndedTokens,
    /// When the wait for the answer ends.
    deadline: Option<Instant>,
    is_declared: bool,
    has_names: bool,
    has_news: bool,
    is_closed: bool,
}

impl Recipients {
    /// Creates the observation of a program of the robot of `place`.
    pub fn new(place: KeySpace) -> Self {
        Self {
            place,
            tokens: HashSet::new(),
            reachable: BTreeMap::new(),
            missing: BTreeSet::new(),
            sought: BTreeSet::new(),
            question: Question::new(QUESTIONS),
            ended: EndedTokens::default(),
            deadline: None,
            is_declared: false,
            has_names: false,
            has_news: false,
            is_closed: false,
        }
    }

    /// Returns whether a robot is reachable. If it is unsure, poll the driver.
    pub fn find(&mut self, robot: &Name, now: Instant) -> Reachability {
        if self.is_closed || self.reachable.contains_key(robot) {
            return Reachability::Reachable;
        }
        if self.missing.contains(robot) {
            let is_complete = self.has_names && self.tokens.len() < MAX_TOKENS;
            return match is_complete {
                true => Reachability::Unreachable(self.others()),
                false => Reachability::Reachable,
            };
        }
        if self.sought.insert(robot.clone()) {
            self.question = Question::new(QUESTIONS);
            self.deadline = Some(now + LONGEST_WAIT);
        }
        match self.deadline {
            Some(_) => Reachability::Unsure,
            None => Reachability::Reachable,
        }
    }

    fn others(&self) -> Vec<Name> {
        let all = self.reachable.keys();
        all.filter(|robot| **robot != self.place.robot)
            .cloned()
            .collect()
    }

    fn on_token(&mut self, key: String, is_deleted: bool) -> Reaction<()> {
        let Some(robot) = self.place.robot_of(&key) else {
            return Reaction::NONE;
        };
        self.has_names = true;
        if is_deleted {
            if self.tokens.remove(&key) {
                if let Some(count) = self.reachable.get_mut(&robot) {
                    *count -= 1;
                }
                self.reachable.retain(|_, count| *count > 0);
            }
            return Reaction::NONE;
        }
        if self.tokens.len() >= MAX_TOKENS || !self.tokens.insert(key) {
            return Reaction::NONE;
        }
        self.missing.remove(&robot);
        self.has_news |= self.sought.contains(&robot);
        *self.reachable.entry(robot).or_default() += 1;
        Reaction {
            polls: self.has_news,
            ..Reaction::NONE
        }
    }

    fn on_answered(&mut self) {
        if self.missing.len() >= MAX_MISSING {
            self.missing.clear();
        }
        let sought = std::mem::take(&mut self.sought).into_iter();
        self.missing
            .extend(sought.filter(|robot| !self.reachable.contains_key(robot)));
        self.deadline = None;
        self.has_news = true;
    }
}

impl Driver for Recipients {
    type Item = ();
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<()> {
        match event {
            Event::Sample { sample, .. } => {
                self.ended.on_sample(&sample.key, sample.is_deleted);
                return self.on_token(sample.key, sample.is_deleted);
            }
            Event::Reply { reply, .. } => match reply {
                Ok(sample) if !self.ended.contains(&sample.key) => {
                    return self.on_token(sample.key, false);
                }
                _ => return Reaction::NONE,
            },
            Event::Ended { .. } => {
                self.ended.on_answered();
                let mut sought = self.sought.iter();
                let is_answered = sought.all(|robot| self.reachable.contains_key(robot));
                self.question.on_ended(now, is_answered);
            }
            Event::Closed => self.is_closed = true,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<(), ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if !std::mem::replace(&mut self.is_declared, true) {
            let key = tokens(&self.place, None);
            let declaration = Declaration::LivelinessSubscriber { key };
            let id = TOKENS;
            return Step::Act(Action::Declare { id, declaration });
        }
        let next = match self.sought.is_empty() {
            true => Next::Wait,
            false => self.question.next(now),
        };
        if next == Next::Ask {
            self.ended.on_asked();
            let get = Get::liveliness(tokens(&self.place, None), TIMEOUT);
            return Step::Act(Action::Get { id: QUERY, get });
        }
        if next == Next::Finish {
            self.on_answered();
        }
        if self.deadline.is_some_and(|deadline| now >= deadline) {
            self.deadline = None;
            self.has_news = true;
        }
        if std::mem::take(&mut self.has_news) {
            return Step::Deliver(());
        }
        let at = match next {
            Next::At(at) => Some(at),
            _ => None,
        };
        Step::Wait(at.into_iter().chain(self.deadline).min())
    }
}

#[cfg(test)]
mod tests {
    use super::{Reachability::*, *};
    use crate::{
        driver::Sample,
        message::{encoding::Encoding, payload::Payload},
    };

    fn name(text: &str) -> Name {
        Name::new(text).expect("valid name")
    }

    fn names(texts: &[&str]) -> Vec<Name> {
        texts.iter().copied().map(name).collect()
    }

    struct Program {
        core: Recipients,
        now: Instant,
    }

    impl Program {
        /// Starts the observation of a program of wombat-1, whose router has a token.
        fn start() -> Self {
            let place = KeySpace {
                fleet: name("rect"),
                robot: name("wombat-1"),
            };
            let core = Recipients::new(place);
            let now = Instant::now();
            let mut program = Self { core, now };
            assert_eq!(program.poll(), (vec!["declare"], None));
            program.token("wombat-1/@rect/alive/1", true);
            program
        }

        /// Returns what is due, in words, and for how long the driver then waits.
        fn poll(&mut self) -> (Vec<&'static str>, Option<Duration>) {
            let mut due = Vec::new();
            loop {
                due.push(match self.core.poll(self.now) {
                    Step::Act(Action::Declare { .. }) => "declare",
                    Step::Act(Action::Get { get, .. }) if get.liveliness => "ask",
                    Step::Deliver(()) => "news",
                    Step::Finished(()) => "finished",
                    Step::Wait(until) => return (due, until.map(|until| until - self.now)),
                    step => panic!("{step:?}"),
                });
                if due.last() == Some(&"finished") {
                    return (due, None);
                }
            }
        }

        fn find(&mut self, robot: &str) -> Reachability {
            self.core.find(&name(robot), self.now)
        }

        fn token(&mut self, key: &str, exists: bool) {
            let sample = Sample {
                key: format!("rect/{key}"),
                payload: Payload::new("", Encoding::BYTES),
                attachment: None,
                is_deleted: !exists,
                priority: Sample::PRIORITY,
            };
            let id = TOKENS;
            let _ = self.core.on_event(self.now, Event::Sample { id, sample });
        }

        fn end(&mut self) -> (Vec<&'static str>, Option<Duration>) {
            let _ = self.core.on_event(self.now, Event::Ended { id: QUERY });
            self.poll()
        }

        fn pass(&mut self, ms: u64) -> (Vec<&'static str>, Option<Duration>) {
            self.now += Duration::from_millis(ms);
            self.poll()
        }

        /// Asks until nobody has answered for long enough.
        fn ask_in_vain(&mut self) {
            assert_eq!(self.poll().0, ["ask"]);
            assert_eq!(self.end().0, ["ask"]);
            assert_eq!(self.end(), (vec![], Some(Duration::from_millis(50))));
            assert_eq!(self.pass(50).0, ["ask"]);
            assert_eq!(self.end(), (vec![], Some(Duration::from_millis(200))));
            assert_eq!(self.pass(200).0, ["ask"]);
            assert_eq!(self.end(), (vec!["news"], None));
        }
    }

    #[test]
    fn robot_is_missing_only_after_the_questions_for_it_and_until_it_has_a_token() {
        let mut program = Program::start();
        program.token("wombat-2/@rect/alive/2", true);
        assert_eq!(program.find("wombat-2"), Reachable);
        assert_eq!(program.poll(), (vec![], None), "nothing is asked");
        assert_eq!(program.find("wombat-3"), Unsure);
        program.ask_in_vain();
        let missing = Unreachable(names(&["wombat-2"]));
        assert_eq!(program.find("wombat-3"), missing);
        assert_eq!(program.poll(), (vec![], None), "it is not asked for again");
        program.token("wombat-3/@rect/alive/3", true);
        assert_eq!(program.find("wombat-3"), Reachable);
    }

    #[test]
    fn token_that_arrives_late_ends_the_wait() {
        let mut program = Program::start();
        assert_eq!(program.find("wombat-2"), Unsure);
        assert_eq!(program.poll().0, ["ask"]);
        assert_eq!(program.end().0, ["ask"]);
        assert_eq!(program.end().0, [""; 0]);
        assert_eq!(program.find("wombat-2"), Unsure);
        program.token("wombat-2/@rect/alive/2", true);
        assert_eq!(program.poll().0, ["news"]);
        assert_eq!(program.find("wombat-2"), Reachable);
        // The question goes on; others wait for its end.
        assert_eq!(program.pass(50).0, ["ask"]);
        assert_eq!(program.end(), (vec!["news"], None));
    }

    #[test]
    fn robot_is_reachable_while_it_has_one_of_several_tokens() {
        let mut program = Program::start();
        for (key, exists) in [("2", true), ("3", true), ("3", true), ("2", false)] {
            program.token(&format!("wombat-2/@rect/alive/{key}"), exists);
        }
        assert_eq!(program.find("wombat-2"), Reachable);
        program.token("wombat-2/@rect/alive/2", false);
        assert_eq!(program.find("wombat-2"), Reachable);
        program.token("wombat-2/@rect/alive/3", false);
        assert_eq!(program.find("wombat-2"), Unsure);
        program.ask_in_vain();
        assert_eq!(program.find("wombat-2"), Unreachable(Vec::new()));
    }

    #[test]
    fn several_robots_are_asked_for_together() {
        let mut program = Program::start();
        assert_eq!(program.find("wombat-2"), Unsure);
        assert_eq!(program.poll().0, ["ask"]);
        assert_eq!(program.find("wombat-3"), Unsure);
        program.ask_in_vain();
        for robot in ["wombat-2", "wombat-3"] {
            assert_eq!(program.find(robot), Unreachable(Vec::new()));
        }
    }

    #[test]
    fn messages_wait_for_a_router_that_does_not_answer_for_a_second_only() {
        let mut program = Program::start();
        assert_eq!(program.find("wombat-2"), Unsure);
        assert_eq!(program.poll(), (vec!["ask"], Some(LONGEST_WAIT)));
        assert_eq!(program.pass(1000), (vec!["news"], None));
        assert_eq!(program.find("wombat-2"), Reachable);
        assert_eq!(program.end().0, ["ask"]);
    }

    #[test]
    fn every_robot_counts_as_reachable_if_it_is_not_known_which_are() {
        let mut unknown = Program::start();
        unknown.core.has_names = false;
        assert_eq!(unknown.find("wombat-2"), Unsure);
        unknown.ask_in_vain();
        assert_eq!(unknown.find("wombat-2"), Reachable);
        let mut crowded = Program::start();
        for number in 0..MAX_TOKENS {
            crowded.token(&format!("w{number}/@rect/alive/1"), true);
        }
        assert_eq!(crowded.find("wombat-2"), Unsure);
        crowded.ask_in_vain();
        assert_eq!(crowded.find("wombat-2"), Reachable);
    }

    #[test]
    fn nothing_is_unreachable_when_the_session_is_closed() {
        let mut program = Program::start();
        assert_eq!(program.find("wombat-2"), Unsure);
        let _ = program.core.on_event(program.now, Event::Closed);
        assert_eq!(program.poll().0, ["finished"]);
        assert_eq!(program.find("wombat-2"), Reachable);
    }
}
