//! Keeps track of the programs of a fleet by their tokens, to report their beginnings and ends as events.
use std::collections::{BTreeMap, BTreeSet};

use super::connection::Event;
use crate::{
    catalogue::{token::Token, Instance},
    name::Name,
};

/// The maximum number of programs that are tracked.
const MAX_PROGRAMS: usize = 4096;

/// The programs that have a name. A program is known while it has a token.
#[derive(Debug)]
pub struct Programs {
    /// The program that observes; it is not reported.
    own: Instance,
    /// The revisions of the tokens. A program declares the next one before it ends the previous one.
    tokens: BTreeMap<(Name, Name, Instance), BTreeSet<u32>>,
}

impl Programs {
    /// Creates the observer of all programs except for one.
    pub fn new(own: Instance) -> Self {
        Self {
            own,
            tokens: BTreeMap::new(),
        }
    }

    /// Handles a token that appeared or ended. Returns an event if the program was not known before, or is not any more.
    pub fn on_token(&mut self, token: Token, is_up: bool) -> Option<Event> {
        let Token {
            robot,
            program,
            instance,
            revision,
        } = token;
        let program = program.filter(|_| instance != self.own)?;
        let key = (robot.clone(), program.clone(), instance);
        if is_up {
            let is_full = self.tokens.len() >= MAX_PROGRAMS;
            if is_full && !self.tokens.contains_key(&key) {
                return None;
            }
            let revisions = self.tokens.entry(key).or_default();
            let is_first = revisions.is_empty();
            revisions.insert(revision);
            return is_first.then_some(Event::ProgramUp { robot, program });
        }
        let revisions = self.tokens.get_mut(&key)?;
        revisions.remove(&revision);
        if !revisions.is_empty() {
            return None;
        }
        self.tokens.remove(&key);
        Some(Event::ProgramDown { robot, program })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn token(program: Option<&str>, instance: u32, revision: u32) -> Token {
        let name = |text| Name::new(text).expect("valid name");
        Token {
            robot: name("wombat-1"),
            program: program.map(name),
            instance: Instance(instance),
            revision,
        }
    }

    fn kinds(events: [Option<Event>; 4]) -> Vec<Option<bool>> {
        let is_up = |event| match event {
            Event::ProgramUp { .. } => true,
            Event::ProgramDown { .. } => false,
            other => panic!("{other:?}"),
        };
        events.map(|event| event.map(is_up)).into()
    }

    #[test]
    fn program_begins_with_its_first_token_and_ends_with_its_last() {
        let mut programs = Programs::new(Instance(0));
        let arm = |revision| token(Some("arm"), 1, revision);
        let events = [
            programs.on_token(arm(0), true),
            programs.on_token(arm(1), true),
            programs.on_token(arm(0), false),
            programs.on_token(arm(1), false),
        ];
        assert_eq!(kinds(events), [Some(true), None, None, Some(false)]);
        assert_eq!(programs.on_token(arm(1), false), None);
    }

    #[test]
    fn own_program_and_those_without_a_name_are_not_reported() {
        let mut programs = Programs::new(Instance(7));
        assert_eq!(programs.on_token(token(Some("arm"), 7, 0), true), None);
        assert_eq!(programs.on_token(token(None, 1, 0), true), None);
    }

    #[test]
    fn flood_of_tokens_is_bounded() {
        let mut programs = Programs::new(Instance(0));
        for instance in 1..=2 * MAX_PROGRAMS as u32 {
            let _ = programs.on_token(token(Some("arm"), instance, 0), true);
        }
        assert_eq!(programs.tokens.len(), MAX_PROGRAMS);
    }
}
