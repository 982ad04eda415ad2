//! Keeps the catalogue of a robot, for its router: accepts registrations of programs, refuses a second server of a topic, and forgets
//! programs whose token has ended.
use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

use super::{token::Token, Instance, Program, ServiceEntry, MAX_BYTES, MAX_PROGRAMS};
use crate::name::{topic::Topic, Name};

/// How long a program may be registered without a token: the token may arrive later than the registration.
const WITHOUT_TOKEN: Duration = Duration::from_secs(10);

/// The catalogue of one robot.
#[derive(Debug, Default)]
pub struct Keeper {
    programs: BTreeMap<Instance, ProgramState>,
    /// The number of the next program, for the order.
    next: u64,
}

#[derive(Debug)]
struct ProgramState {
    number: u64,
    name: Option<Name>,
    /// Empty until the program has registered.
    services: Vec<ServiceEntry>,
    /// The revisions of its tokens. A program declares the next one before it ends the previous one.
    tokens: BTreeSet<u32>,
    since: Instant,
}

/// Why a registration is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// Another program serves the topic.
    #[error(
        "{topic} is served by {} already. End that program, choose another topic, or allow several programs to serve it in both",
        named(.by.as_ref())
    )]
    Served {
        /// The topic.
        topic: Topic,
        /// The name of the other program, if it has one.
        by: Option<Name>,
        /// The run of the other program.
        instance: Instance,
    },
    /// There are too many programs.
    #[error("{MAX_PROGRAMS} programs are known at this robot, and no more are kept: end some")]
    TooMany,
    /// The catalogue would become too large.
    #[error("the programs of this robot describe more than {MAX_BYTES} bytes of services: shorten the descriptions")]
    TooLarge,
}

fn named(program: Option<&Name>) -> String {
    program.map_or_else(
        || "another program".to_owned(),
        |name| format!("the program {name}"),
    )
}

impl Keeper {
    /// Handles a token of a program of this robot that appeared or ended.
    pub fn on_token(&mut self, token: &Token, is_up: bool, now: Instant) {
        if !is_up {
            if let Some(known) = self.programs.get_mut(&token.instance) {
                known.tokens.remove(&token.revision);
                if known.tokens.is_empty() {
                    self.programs.remove(&token.instance);
                }
            }
            return;
        }
        self.forget_those_without_token(now);
        if self.programs.len() >= MAX_PROGRAMS && !self.programs.contains_key(&token.instance) {
            return;
        }
        let known = self.known(token.instance, token.program.as_ref(), now);
        known.tokens.insert(token.revision);
    }

    /// Registers what a program serves, in place of what it has registered before. Returns a warning for the program, if there is a
    /// reason for one.
    ///
    /// # Errors
    /// Returns why nothing was registered.
    pub fn register(&mut self, program: Program, now: Instant) -> Result<Option<String>, Refused> {
        self.forget_those_without_token(now);
        let instance = program.instance;
        if self.programs.len() >= MAX_PROGRAMS && !self.programs.contains_key(&instance) {
            return Err(Refused::TooMany);
        }
        let others = || {
            self.programs
                .iter()
                .filter(|(other, _)| **other != instance)
        };
        for service in &program.services {
            for (&instance, other) in others() {
                if other.services.iter().any(|served| served.excludes(service)) {
                    return Err(Refused::Served {
                        topic: service.topic.clone(),
                        by: other.name.clone(),
                        instance,
                    });
                }
            }
        }
        let size: usize = others().map(|(_, other)| size(&other.services)).sum();
        if size + self::size(&program.services) > MAX_BYTES {
            return Err(Refused::TooLarge);
        }
        let twice = (program.name.as_ref()).filter(|name| {
            let is_same = |(_, other): (_, &ProgramState)| other.name.as_ref() == Some(name);
            others().any(is_same)
        });
        let warning = twice.map(|name| {
            format!("another program {name} runs at this robot: end one of them, or give them different names")
        });
        let known = self.known(instance, program.name.as_ref(), now);
        known.services = program.services;
        Ok(warning)
    }

    /// Handles that a program did not answer in time: another one may serve its topics. Returns a description of it for the other one.
    pub fn on_silent(&mut self, instance: Instance) -> Option<String> {
        let silent = self.programs.get_mut(&instance)?;
        silent.services.clear();
        Some(format!(
            "{} of this robot does not answer: this program takes over what it serves. End it",
            named(silent.name.as_ref())
        ))
    }

    /// Returns the catalogue: all programs, in the order in which they became known.
    pub fn programs(&mut self, now: Instant) -> Vec<Program> {
        self.forget_those_without_token(now);
        let mut programs: Vec<_> = self.programs.iter().collect();
        programs.sort_by_key(|(_, known)| known.number);
        let programs = programs.into_iter().map(|(&instance, known)| Program {
            name: known.name.clone(),
            instance,
            services: known.services.clone(),
        });
        programs.collect()
    }

    fn known(
        &mut self,
        instance: Instance,
        name: Option<&Name>,
        now: Instant,
    ) -> &mut ProgramState {
        let next = &mut self.next;
        self.programs.entry(instance).or_insert_with(|| {
            *next += 1;
            ProgramState {
                number: *next,
                name: name.cloned(),
                services: Vec::new(),
                tokens: BTreeSet::new(),
                since: now,
            }
        })
    }

    fn forget_those_without_token(&mut self, now: Instant) {
        self.programs.retain(|_, known| {
            !known.tokens.is_empty() || now.saturating_duration_since(known.since) < WITHOUT_TOKEN
        });
    }
}

/// Returns about how many bytes services take in the catalogue.
fn size(services: &[ServiceEntry]) -> usize {
    let size = |service: &ServiceEntry| {
        let parameters = service.parameters.as_ref();
        let json = parameters.map(|parameters| serde_json::to_vec(parameters).unwrap_or_default());
        let parameters = json.map_or(0, |json| json.len());
        40 + service.topic.as_str().len() + 2 * service.about.len() + parameters
    };
    services.iter().map(size).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue::{self, MAX_ABOUT, MAX_SERVICES};

    fn program(name: Option<&str>, instance: u32, services: &[(&str, bool)]) -> Program {
        let service = |&(topic, several): &(&str, bool)| {
            ServiceEntry::new(Topic::new(topic).expect("valid"), "", several)
        };
        Program {
            name: name.map(|name| Name::new(name).expect("valid")),
            instance: Instance(instance),
            services: services.iter().map(service).collect(),
        }
    }

    fn token(name: Option<&str>, instance: u32, revision: u32) -> Token {
        Token {
            robot: Name::new("wombat-1").expect("valid"),
            program: name.map(|name| Name::new(name).expect("valid")),
            instance: Instance(instance),
            revision,
        }
    }

    fn names(keeper: &mut Keeper, now: Instant) -> Vec<(Option<String>, usize)> {
        let named = |program: &Program| program.name.as_ref().map(Name::to_string);
        let programs = keeper.programs(now);
        programs
            .iter()
            .map(|program| (named(program), program.services.len()))
            .collect()
    }

    #[test]
    fn programs_stand_in_the_catalogue_as_long_as_they_have_a_token() {
        let (mut keeper, now) = (Keeper::default(), Instant::now());
        keeper.on_token(&token(Some("drive"), 2, 0), true, now);
        keeper.on_token(&token(Some("arm"), 1, 0), true, now);
        let arm = program(Some("arm"), 1, &[("grab", false)]);
        assert_eq!(keeper.register(arm, now), Ok(None));
        let (drive, arm) = (Some("drive".to_owned()), Some("arm".to_owned()));
        assert_eq!(
            names(&mut keeper, now),
            [(drive.clone(), 0), (arm.clone(), 1)]
        );
        // The next revision appears before the previous one ends.
        keeper.on_token(&token(Some("arm"), 1, 1), true, now);
        keeper.on_token(&token(Some("arm"), 1, 0), false, now);
        assert_eq!(names(&mut keeper, now).len(), 2);
        keeper.on_token(&token(Some("arm"), 1, 1), false, now);
        assert_eq!(names(&mut keeper, now), [(drive, 0)]);
    }

    #[test]
    fn program_whose_token_does_not_follow_is_forgotten() {
        let (mut keeper, now) = (Keeper::default(), Instant::now());
        assert_eq!(
            keeper.register(program(None, 1, &[("grab", false)]), now),
            Ok(None)
        );
        assert_eq!(names(&mut keeper, now), [(None, 1)]);
        assert_eq!(names(&mut keeper, now + WITHOUT_TOKEN), []);
    }

    #[test]
    fn second_server_of_a_topic_is_refused_unless_both_allow_it() {
        let (mut keeper, now) = (Keeper::default(), Instant::now());
        let grab = |name, instance, several| program(name, instance, &[("grab", several)]);
        assert_eq!(keeper.register(grab(Some("arm"), 1, false), now), Ok(None));
        for several in [false, true] {
            let refused = keeper.register(grab(Some("claw"), 2, several), now);
            let text = refused.expect_err("served already").to_string();
            assert!(
                text.starts_with("grab is served by the program arm already"),
                "{text}"
            );
        }
        // The program itself may register again, and others after its end.
        assert_eq!(keeper.register(grab(Some("arm"), 1, true), now), Ok(None));
        assert_eq!(keeper.register(grab(None, 2, true), now), Ok(None));
        keeper.on_token(&token(None, 2, 1), true, now);
        keeper.on_token(&token(None, 2, 1), false, now);
        assert_eq!(keeper.register(grab(Some("arm"), 1, false), now), Ok(None));
    }

    #[test]
    fn program_takes_over_from_one_that_does_not_answer() {
        let (mut keeper, now) = (Keeper::default(), Instant::now());
        let grab = |instance| program(Some("arm"), instance, &[("grab", false)]);
        assert_eq!(keeper.register(grab(1), now), Ok(None));
        let refused = keeper.register(grab(2), now);
        assert!(
            matches!(refused, Err(Refused::Served { instance, .. }) if instance == Instance(1))
        );
        let warning = keeper.on_silent(Instance(1)).expect("it is known");
        assert!(warning.starts_with("the program arm"), "{warning}");
        assert!(keeper.register(grab(2), now).is_ok());
        // The first one is refused when it is back.
        assert!(keeper.register(grab(1), now).is_err());
        assert_eq!(keeper.on_silent(Instance(3)), None);
    }

    #[test]
    fn second_program_of_a_name_is_reported_to_it() {
        let (mut keeper, now) = (Keeper::default(), Instant::now());
        keeper.on_token(&token(Some("arm"), 1, 0), true, now);
        let warning = keeper
            .register(program(Some("arm"), 2, &[]), now)
            .expect("registered");
        assert!(warning
            .expect("a warning")
            .starts_with("another program arm runs at this robot"));
    }

    #[test]
    fn flood_of_programs_and_descriptions_is_bounded() {
        let (mut keeper, now) = (Keeper::default(), Instant::now());
        for instance in 0..1000 {
            keeper.on_token(&token(None, instance, 0), true, now);
        }
        assert_eq!(names(&mut keeper, now).len(), MAX_PROGRAMS);
        assert_eq!(
            keeper.register(program(None, 5000, &[]), now),
            Err(Refused::TooMany)
        );
        let mut refused = false;
        for instance in 0..MAX_PROGRAMS as u32 {
            let service = |n| {
                let topic = Topic::new(&format!("p{instance}/{n}")).expect("valid");
                ServiceEntry::new(topic, &"x".repeat(MAX_ABOUT), false)
            };
            let services = (0..MAX_SERVICES).map(service).collect();
            let large = Program {
                services,
                ..program(None, instance, &[])
            };
            refused |= keeper.register(large, now) == Err(Refused::TooLarge);
        }
        assert!(refused);
        let json = serde_json::to_vec(&keeper.programs(now)).expect("JSON");
        assert!(catalogue::read(&json).is_ok());
    }
}
