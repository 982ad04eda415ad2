//! Keeps what each robot has answered to a stop; logic without I/O.
use std::{collections::BTreeMap, time::Duration};

use rect::Name;

/// The answer of a robot.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Nothing yet.
    Waiting,
    /// Its service has confirmed the stop, so long after it was pressed.
    Confirmed(Duration),
    /// Its service has replied with an error, or the reply cannot be read.
    Failed(String),
    /// No program of the robot provides the service.
    NoService,
    /// Nothing within the time.
    Silent,
}

/// The answers of the robots, one for each.
#[derive(Default)]
pub struct Answers(BTreeMap<Name, Answer>);

impl Answers {
    /// Returns the answers of these robots, which have not answered yet.
    pub fn of(robots: impl Iterator<Item = Name>) -> Self {
        Self(robots.map(|robot| (robot, Answer::Waiting)).collect())
    }

    /// Handles an answer. A confirmation remains, whatever follows.
    pub fn on_answer(&mut self, robot: Name, answer: Answer) {
        let known = self.0.entry(robot).or_insert(Answer::Waiting);
        if !matches!(known, Answer::Confirmed(_)) {
            *known = answer;
        }
    }

    /// Waits again for the robots that have not confirmed.
    pub fn ask_again(&mut self) {
        for answer in self.0.values_mut() {
            if !matches!(answer, Answer::Confirmed(_)) {
                *answer = Answer::Waiting;
            }
        }
    }

    /// Handles that the router is lost. A robot seemed to have no service if the request has not left this computer.
    pub fn on_router_lost(&mut self) {
        for answer in self.0.values_mut() {
            if *answer == Answer::NoService {
                *answer = Answer::Waiting;
            }
        }
    }

    /// Returns the robots that have not answered.
    pub fn waiting(&self) -> impl Iterator<Item = &Name> {
        let waiting = self
            .0
            .iter()
            .filter(|(_, answer)| **answer == Answer::Waiting);
        waiting.map(|(robot, _)| robot)
    }

    /// Returns whether a robot has confirmed.
    pub fn has_confirmed(&self, robot: &Name) -> bool {
        matches!(self.0.get(robot), Some(Answer::Confirmed(_)))
    }

    /// Returns whether all robots have confirmed.
    pub fn are_confirmed(&self) -> bool {
        self.0.keys().all(|robot| self.has_confirmed(robot))
    }

    /// Returns the robots with their answers, in alphabetical order.
    pub fn all(&self) -> impl Iterator<Item = (&Name, &Answer)> {
        self.0.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(robot: &str) -> Name {
        Name::new(robot).expect("a name")
    }

    fn answers(robots: &[&str]) -> Answers {
        Answers::of(robots.iter().map(|robot| name(robot)))
    }

    fn texts(answers: &Answers) -> Vec<String> {
        let all = answers.all();
        all.map(|(robot, answer)| format!("{robot} {answer:?}"))
            .collect()
    }

    #[test]
    fn a_robot_confirms_once_and_a_confirmation_remains() {
        let mut answers = answers(&["a", "b"]);
        for ms in 3..3000 {
            answers.on_answer(name("a"), Answer::Confirmed(Duration::from_millis(ms)));
        }
        for later in [
            Answer::Silent,
            Answer::NoService,
            Answer::Failed("no".into()),
        ] {
            answers.on_answer(name("a"), later);
        }
        answers.ask_again();
        answers.on_router_lost();
        assert_eq!(texts(&answers), ["a Confirmed(3ms)", "b Waiting"]);
        assert!(answers.has_confirmed(&name("a")) && !answers.are_confirmed());
        answers.on_answer(name("b"), Answer::Confirmed(Duration::ZERO));
        assert!(answers.are_confirmed());
    }

    #[test]
    fn a_late_confirmation_replaces_every_other_answer() {
        for before in [
            Answer::Silent,
            Answer::NoService,
            Answer::Failed("no".into()),
        ] {
            let mut answers = answers(&["a"]);
            answers.on_answer(name("a"), before);
            answers.on_answer(name("a"), Answer::Confirmed(Duration::from_secs(9)));
            assert_eq!(texts(&answers), ["a Confirmed(9s)"]);
        }
    }

    #[test]
    fn robots_that_have_not_confirmed_are_asked_again() {
        let mut answers = answers(&["a", "b", "c", "d"]);
        answers.on_answer(name("a"), Answer::Confirmed(Duration::ZERO));
        answers.on_answer(name("b"), Answer::NoService);
        answers.on_answer(name("c"), Answer::Failed("stuck".into()));
        let waiting =
            |answers: &Answers| answers.waiting().map(Name::to_string).collect::<String>();
        assert_eq!(waiting(&answers), "d");
        answers.on_router_lost();
        assert_eq!(waiting(&answers), "bd");
        answers.ask_again();
        assert_eq!(waiting(&answers), "bcd");
    }

    #[test]
    fn a_robot_that_was_not_known_is_added_by_its_answer() {
        let mut answers = answers(&[]);
        answers.on_answer(name("gripper"), Answer::Confirmed(Duration::ZERO));
        assert_eq!(texts(&answers), ["gripper Confirmed(0ns)"]);
    }
}
