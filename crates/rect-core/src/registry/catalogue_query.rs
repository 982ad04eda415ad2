//! Drives the question what a robot offers. An answer is kept as long as the robot's programs have the same tokens, so that nothing
//! crosses the air to ask again.
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use super::{RegistryError, RegistryQuery};
use crate::{
    catalogue::{
        self,
        token::{self, Token},
        Instance, CATALOGUE, MAX_PROGRAMS,
    },
    driver::{Action, Driver, Event, Get, Id, Reaction, Step},
    message::payload::Payload,
    name::{key::KeySpace, Name},
};

/// The timeout of the question for the tokens, which the program's own router answers.
const TIMEOUT: Duration = Duration::from_secs(2);
/// The maximum number of robots whose catalogue is kept.
const MAX_KEPT: usize = 64;
const TOKENS: Id = Id(0);

/// The programs of a robot, each with the revision of what it serves.
pub(super) type Revisions = BTreeSet<(Instance, u32)>;

/// The last catalogues of robots. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Catalogues(Arc<Mutex<BTreeMap<Name, (Revisions, Payload)>>>);

/// The question to one robot. Finishes with the JSON of its catalogue.
#[derive(Debug)]
pub struct CatalogueQuery {
    kept: Catalogues,
    place: KeySpace,
    robot: Name,
    revisions: Revisions,
    state: State,
}

#[derive(Debug)]
enum State {
    AskTokens,
    AskingTokens,
    Asking(Box<RegistryQuery>),
    Answered(Payload),
    Closed,
}

impl Catalogues {
    /// Creates the question of a program of the robot of `place` to `robot`.
    pub fn query(&self, place: KeySpace, robot: Name) -> CatalogueQuery {
        // The own router answers without bytes on the air, and before the revision is announced.
        let state = match robot == place.robot {
            true => State::ask(&place, &robot),
            false => State::AskTokens,
        };
        CatalogueQuery {
            kept: self.clone(),
            place,
            robot,
            revisions: Revisions::new(),
            state,
        }
    }

    /// Returns the catalogue of a robot, if it is that of these revisions. A robot without programs may be one that cannot be reached.
    pub(super) fn get(&self, robot: &Name, revisions: &Revisions) -> Option<Payload> {
        let kept = self.lock();
        let (of, catalogue) = kept.get(robot)?;
        (!revisions.is_empty() && of == revisions).then(|| catalogue.clone())
    }

    /// Keeps the catalogue of a robot, if it lists the programs of these revisions. A router that is busy may list a program for a moment
    /// after its token has ended here, and nothing would correct what is kept then.
    pub(super) fn keep(&self, robot: &Name, revisions: Revisions, catalogue: &Payload) {
        let programs = catalogue::read(&catalogue.bytes).unwrap_or_default();
        let listed: BTreeSet<_> = programs.iter().map(|program| program.instance).collect();
        let expected: BTreeSet<_> = revisions.iter().map(|(instance, _)| *instance).collect();
        let mut kept = self.lock();
        if listed != expected {
            kept.remove(robot);
            return;
        }
        if kept.len() >= MAX_KEPT && !kept.contains_key(robot) {
            kept.clear();
        }
        kept.insert(robot.clone(), (revisions, catalogue.clone()));
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<Name, (Revisions, Payload)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn ask(place: &KeySpace, robot: &Name) -> Self {
        let query = RegistryQuery::new(place.clone(), robot.clone(), CATALOGUE, "");
        Self::Asking(Box::new(query))
    }
}

impl CatalogueQuery {
    fn on_token(&mut self, key: &str) {
        let token = Token::parse(&self.place, key).filter(|token| token.robot == self.robot);
        if self.revisions.len() < 2 * MAX_PROGRAMS {
            let revision = |token: Token| (token.instance, token.revision);
            self.revisions.extend(token.map(revision));
        }
    }
}

impl Driver for CatalogueQuery {
    type Item = std::convert::Infallible;
    type Output = Result<Payload, RegistryError>;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        match (&mut self.state, event) {
            (State::Asking(query), event) => return query.on_event(now, event),
            (_, Event::Closed) => self.state = State::Closed,
            (State::AskingTokens, Event::Reply { reply, .. }) => {
                if let Ok(sample) = reply {
                    self.on_token(&sample.key);
                }
                return Reaction::NONE;
            }
            (State::AskingTokens, Event::Ended { .. }) => {
                self.state = match self.kept.get(&self.robot, &self.revisions) {
                    Some(catalogue) => State::Answered(catalogue),
                    None => State::ask(&self.place, &self.robot),
                };
            }
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        match &mut self.state {
            State::AskTokens => {
                self.state = State::AskingTokens;
                let tokens = token::tokens(&self.place, Some(&self.robot));
                let get = Get::liveliness(tokens, TIMEOUT);
                Step::Act(Action::Get { id: TOKENS, get })
            }
            State::AskingTokens => Step::Wait(None),
            State::Asking(query) => {
                let step = query.poll(now);
                if let Step::Finished(Ok(catalogue)) = &step {
                    let revisions = std::mem::take(&mut self.revisions);
                    self.kept.keep(&self.robot, revisions, catalogue);
                }
                step
            }
            State::Answered(catalogue) => Step::Finished(Ok(catalogue.clone())),
            State::Closed => Step::Finished(Err(RegistryError::Closed)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{driver::Sample, message::encoding::Encoding};

    fn name(text: &str) -> Name {
        Name::new(text).expect("valid name")
    }

    fn sample(key: &str, payload: &str) -> Sample {
        Sample {
            key: key.to_owned(),
            payload: Payload::new(payload.to_owned(), Encoding::JSON),
            is_deleted: false,
            priority: Sample::PRIORITY,
            attachment: None,
        }
    }

    /// Returns the JSON of a catalogue with these programs, each of which serves one topic.
    fn listing(instances: &[&str], topic: &str) -> String {
        let program = |instance: &&str| {
            format!(r#"{{"instance":"{instance}","services":[{{"topic":"{topic}"}}]}}"#)
        };
        let programs: Vec<_> = instances.iter().map(program).collect();
        format!("[{}]", programs.join(","))
    }

    /// Asks for the catalogue while these are the tokens. Returns what it is, and whether the robot's router was asked.
    fn ask(
        catalogues: &Catalogues,
        tokens: &[&str],
        answer: &str,
    ) -> (Result<String, RegistryError>, bool) {
        let place = KeySpace {
            fleet: name("rect"),
            robot: name("laptop"),
        };
        let (mut query, now) = (catalogues.query(place, name("wombat-1")), Instant::now());
        let mut is_asked = false;
        loop {
            match query.poll(now) {
                Step::Act(Action::Get { id: TOKENS, .. }) => {
                    for token in tokens {
                        let reply = Ok(sample(&format!("rect/wombat-1/@rect/p/{token}"), ""));
                        let _ = query.on_event(now, Event::Reply { id: TOKENS, reply });
                    }
                    let _ = query.on_event(now, Event::Ended { id: TOKENS });
                }
                Step::Act(Action::Get { id, .. }) => {
                    is_asked = true;
                    let reply = Ok(sample("rect/wombat-1/@rect/catalogue", answer));
                    let _ = query.on_event(now, Event::Reply { id, reply });
                }
                Step::Finished(found) => {
                    let text = |found: Payload| String::from_utf8_lossy(&found.bytes).into_owned();
                    return (found.map(text), is_asked);
                }
                step => panic!("{step:?}"),
            }
        }
    }

    #[test]
    fn catalogue_is_kept_until_a_revision_changes() {
        let catalogues = Catalogues::default();
        let (arm, later) = ("arm/0000001f/0", "arm/0000001f/1");
        let (one, two) = (listing(&["0000001f"], "one"), listing(&["0000001f"], "two"));
        assert_eq!(ask(&catalogues, &[arm], &one), (Ok(one.clone()), true));
        assert_eq!(ask(&catalogues, &[arm], &two), (Ok(one.clone()), false));
        assert_eq!(ask(&catalogues, &[later], &two), (Ok(two.clone()), true));
        let three = listing(&["0000001f", "00000020"], "three");
        let found = ask(&catalogues, &[later, "~/00000020/0"], &three);
        assert_eq!(found, (Ok(three), true));
    }

    #[test]
    fn catalogue_that_lists_a_program_without_a_token_is_not_kept() {
        let catalogues = Catalogues::default();
        let (drive, arm) = ("drive/00000020/0", "arm/0000001f/0");
        let (both, one) = (
            listing(&["0000001f", "00000020"], "both"),
            listing(&["00000020"], "one"),
        );
        assert_eq!(
            ask(&catalogues, &[drive, arm], &both),
            (Ok(both.clone()), true)
        );
        // The router does not know of the end yet.
        assert_eq!(ask(&catalogues, &[drive], &both), (Ok(both), true));
        assert_eq!(ask(&catalogues, &[drive], &one), (Ok(one.clone()), true));
        assert_eq!(ask(&catalogues, &[drive], ""), (Ok(one), false));
    }

    #[test]
    fn robot_without_programs_is_asked_each_time() {
        let catalogues = Catalogues::default();
        assert_eq!(ask(&catalogues, &[], "[]"), (Ok("[]".into()), true));
        assert_eq!(ask(&catalogues, &[], "[]"), (Ok("[]".into()), true));
    }

    #[test]
    fn wrong_tokens_count_for_nothing() {
        let catalogues = Catalogues::default();
        let _ = ask(&catalogues, &["arm/zz/0", "a/b/c/d"], "[]");
        assert_eq!(catalogues.lock()[&name("wombat-1")].0, Revisions::new());
    }

    #[test]
    fn catalogues_of_a_bounded_number_of_robots_are_kept() {
        let catalogues = Catalogues::default();
        for number in 0..2 * MAX_KEPT {
            let robot = name(&format!("wombat-{number}"));
            let answer = Payload::new("[]", Encoding::JSON);
            catalogues.keep(&robot, Revisions::new(), &answer);
            assert!(catalogues.lock().len() <= MAX_KEPT);
        }
    }
}
