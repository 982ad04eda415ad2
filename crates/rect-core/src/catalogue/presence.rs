//! Drives the presence of a program: its token, its registration at the router, and without a router its catalogue.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::{
    registration::{get, registered, Registered},
    token::Token,
    Instance, Program, ServiceEntry, CATALOGUE, MAX_SERVICES,
};
use crate::{
    driver::{Action, Answer, Declaration, Driver, Event, Id, QueryId, Reaction, Step},
    message::{encoding::Encoding, payload::Payload},
    name::{key::KeySpace, topic::Topic, Name},
    session::requester_end,
};

/// The pause before a registration that nobody has answered is repeated. It doubles until [`LONGEST_PAUSE`]: only the program's own
/// router is asked.
const PAUSE: Duration = Duration::from_secs(1);
const LONGEST_PAUSE: Duration = Duration::from_secs(64);
/// The shortest time between two revisions, since each is announced to all robots.
const BETWEEN_REVISIONS: Duration = Duration::from_secs(1);
const REGISTRATION: Id = Id(0);
const LINKS: Id = Id(1);
const QUERYABLE: Id = Id(2);
/// The query that passes on that a requester has closed its request.
const PASSED_ON: Id = Id(3);
/// The id of the token of revision 0; the next ones follow.
const FIRST_TOKEN: u64 = 16;

/// The presence of a program. Delivers warnings for its user.
///
/// A program without a name that serves nothing has no token.
#[derive(Debug)]
pub struct ProgramPresence {
    place: KeySpace,
    is_direct: bool,
    program: Program,
    /// The services that are being registered.
    offered: Vec<ServiceEntry>,
    revision: u32,
    /// The revision of the declared token, and since when.
    declared: Option<(u32, Instant)>,
    is_registered: bool,
    is_registering: bool,
    /// Whether the router has answered the registration that is under way.
    is_answered: bool,
    /// When to repeat a registration that nobody has answered, and the pause after that.
    repeat_at: Option<Instant>,
    pause: Duration,
    warnings: Warnings,
    actions: VecDeque<Action>,
    questions: VecDeque<QueryId>,
    is_closed: bool,
}

impl ProgramPresence {
    /// Creates the presence of a program of the robot of `place`. `instance` is a random number. `is_direct`: the program has links of
    /// its own and no router.
    pub fn new(place: KeySpace, name: Option<Name>, instance: u32, is_direct: bool) -> Self {
        let (id, declaration) = match is_direct {
            true => {
                let key = place.own(Some(&place.robot), CATALOGUE);
                let complete = true;
                (QUERYABLE, Declaration::Queryable { key, complete })
            }
            false => (LINKS, Declaration::LinkListener),
        };
        Self {
            // The router reports a second program of the name.
            is_registered: name.is_none(),
            is_registering: false,
            is_answered: false,
            repeat_at: None,
            pause: PAUSE,
            warnings: Warnings::default(),
            program: Program {
                name,
                instance: Instance(instance),
                services: Vec::new(),
            },
            offered: Vec::new(),
            place,
            is_direct,
            revision: 0,
            declared: None,
            actions: [Action::Declare { id, declaration }].into(),
            questions: VecDeque::new(),
            is_closed: false,
        }
    }

    /// Begins to offer a service, until [`on_ended`](Self::on_ended). Returns the program with that service, for a
    /// [`Registration`](super::registration::Registration). Without a router there is nobody to register at.
    ///
    /// # Errors
    /// Returns why the program cannot serve it.
    pub fn offer(&mut self, service: &ServiceEntry) -> Result<Program, String> {
        let own = self.program.services.iter().chain(&self.offered);
        if own.clone().any(|other| other.excludes(service)) {
            return Err(format!(
                "{} is served by this program already. End that service, choose another topic, or allow several programs to serve it in both",
                service.topic
            ));
        }
        if own.count() >= MAX_SERVICES {
            return Err(format!("a program serves at most {MAX_SERVICES} topics"));
        }
        let mut program = self.program.clone();
        program.add(service.clone());
        self.offered.push(service.clone());
        Ok(program)
    }

    /// Handles that the program serves what it has offered: the service with which `program` was registered.
    pub fn on_served(&mut self, service: ServiceEntry, program: &Program, registered: Registered) {
        self.take_offered(&service.topic);
        self.program.add(service);
        // Another service may have been added or removed meanwhile.
        let is_current = self.program.services == program.services;
        self.is_registered &= is_current && registered != Registered::Unanswered;
        self.warnings.add(registered);
        self.revision = self.revision.wrapping_add(1);
    }

    /// Handles that a service has ended, or is not offered any more.
    pub fn on_ended(&mut self, topic: &Topic) {
        if self.take_offered(topic) {
            return;
        }
        let services = &mut self.program.services;
        if let Some(at) = services.iter().position(|service| service.topic == *topic) {
            services.remove(at);
            self.is_registered = false;
            self.revision = self.revision.wrapping_add(1);
        }
    }

    /// Handles that another program serves a topic, because this one did not answer.
    pub fn on_taken_over(&mut self, topic: &Topic) {
        self.on_ended(topic);
        self.warnings.next = Some(format!(
            "this program did not answer for some time, and another one serves {topic} now: the service of this one has ended"
        ));
    }

    fn take_offered(&mut self, topic: &Topic) -> bool {
        let at = self
            .offered
            .iter()
            .position(|offered| offered.topic == *topic);
        at.map(|at| self.offered.swap_remove(at)).is_some()
    }

    /// Returns what the program serves.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// Returns the token of a revision.
    fn token(&self, revision: u32) -> Declaration {
        let token = Token {
            robot: self.place.robot.clone(),
            program: self.program.name.clone(),
            instance: self.program.instance,
            revision,
        };
        Declaration::LivelinessToken {
            key: token.key(&self.place.fleet),
        }
    }

    /// Declares the token of the current revision, and ends the previous one, if it is time. Returns when it will be.
    fn poll_token(&mut self, now: Instant) -> Option<Instant> {
        let has_token = self.program.name.is_some() || !self.program.services.is_empty();
        let required = has_token.then_some(self.revision);
        let at = match self.declared {
            Some((declared, _)) if required == Some(declared) => return None,
            // The catalogue must have what the revision announces.
            Some(_) if self.is_registering => return None,
            Some((_, since)) => since + BETWEEN_REVISIONS,
            None if required.is_none() => return None,
            None => now,
        };
        if now < at {
            return Some(at);
        }
        // The next token comes first, so that the program is known all the time.
        if let Some(revision) = required {
            let declaration = self.token(revision);
            let id = token_id(revision);
            self.actions.push_back(Action::Declare { id, declaration });
        }
        if let Some((revision, _)) = self.declared {
            let id = token_id(revision);
            self.actions.push_back(Action::Undeclare { id });
        }
        self.declared = required.map(|revision| (revision, now));
        None
    }
}

/// The problems that the router has told. One that it repeats is reported once.
#[derive(Debug, Default)]
struct Warnings {
    last: Option<String>,
    next: Option<String>,
}

impl Warnings {
    fn add(&mut self, registered: Registered) {
        let warning = match registered {
            Registered::Accepted(warning) => warning,
            Registered::Refused(reason) => Some(reason),
            Registered::Unanswered | Registered::Closed => None,
        };
        if let Some(warning) = warning.filter(|warning| self.last.as_ref() != Some(warning)) {
            self.last = Some(warning.clone());
            self.next = Some(warning);
        }
    }
}

fn token_id(revision: u32) -> Id {
    Id(FIRST_TOKEN + u64::from(revision))
}

impl Driver for ProgramPresence {
    type Item = String;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<String> {
        match event {
            Event::Link { up: true, .. } => {
                // The router may be another one, which knows nothing yet.
                self.is_registered &= self.declared.is_none();
                (self.repeat_at, self.pause) = (None, PAUSE);
                // A robot that has asked before the program is registered again must ask once more.
                if self.declared.is_some() {
                    self.revision = self.revision.wrapping_add(1);
                }
            }
            Event::Reply {
                id: REGISTRATION,
                reply,
            } => {
                let registered = registered(reply.map(|sample| sample.payload));
                self.is_answered |= registered != Registered::Unanswered;
                self.warnings.add(registered);
            }
            Event::Ended { id: REGISTRATION } => {
                self.is_registering = false;
                self.is_registered &= self.is_answered;
                self.repeat_at = (!self.is_answered).then_some(now + self.pause);
                self.pause = match self.is_answered {
                    true => PAUSE,
                    false => LONGEST_PAUSE.min(2 * self.pause),
                };
            }
            Event::Query { query, payload, .. } => {
                match requester_end::passed_on(&self.place, &payload.bytes) {
                    Some((topic, get)) => {
                        let id = PASSED_ON;
                        let is_served = self.program.serves(&topic);
                        let pass_on = is_served.then_some(Action::Get { id, get });
                        self.actions.extend(pass_on);
                        let answer = Answer::None;
                        self.actions.push_back(Action::Answer { query, answer });
                    }
                    None => self.questions.push_back(query),
                }
            }
            Event::Closed => self.is_closed = true,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<String, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if let Some(warning) = self.warnings.next.take() {
            return Step::Deliver(warning);
        }
        let waits = self.repeat_at.filter(|at| !self.is_registered && now < *at);
        let is_due = !self.is_direct && !self.is_registered && !self.is_registering;
        if is_due && waits.is_none() {
            (self.is_registered, self.is_registering, self.is_answered) = (true, true, false);
            let get = get(&self.place, &self.program);
            let id = REGISTRATION;
            return Step::Act(Action::Get { id, get });
        }
        let token_at = self.poll_token(now);
        if let Some(action) = self.actions.pop_front() {
            return Step::Act(action);
        }
        let Some(query) = self.questions.pop_front() else {
            return Step::Wait(token_at.into_iter().chain(waits).min());
        };
        let answer = Answer::Reply {
            key: self.place.own(Some(&self.place.robot), CATALOGUE),
            payload: Payload::new(format!("[{}]", self.program.to_json()), Encoding::JSON),
        };
        Step::Act(Action::Answer { query, answer })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::driver::Sample;

    fn name(text: &str) -> Name {
        Name::new(text).expect("valid name")
    }

    fn presence(program: Option<&str>, is_direct: bool) -> ProgramPresence {
        let place = KeySpace {
            fleet: name("rect"),
            robot: name("wombat-1"),
        };
        ProgramPresence::new(place, program.map(name), 0x1f, is_direct)
    }

    fn service(topic: &str) -> ServiceEntry {
        ServiceEntry::new(Topic::new(topic).expect("valid topic"), "", false)
    }

    /// Returns the actions that are due, in words, and until when the driver waits.
    fn actions(presence: &mut ProgramPresence, now: Instant) -> (Vec<String>, Option<Instant>) {
        let mut all = Vec::new();
        loop {
            match presence.poll(now) {
                Step::Act(Action::Declare {
                    declaration: Declaration::LivelinessToken { key },
                    ..
                }) => all.push(format!("token {key}")),
                Step::Act(Action::Declare { .. }) => all.push("declare".to_owned()),
                Step::Act(Action::Undeclare { id }) => {
                    all.push(format!("end {}", id.0 - FIRST_TOKEN))
                }
                Step::Act(Action::Get { get, .. }) => all.push(format!("ask {}", get.selector)),
                Step::Act(Action::Answer {
                    answer: Answer::Reply { payload, .. },
                    ..
                }) => {
                    all.push(String::from_utf8_lossy(&payload.bytes).into_owned());
                }
                Step::Deliver(warning) => all.push(warning),
                Step::Wait(until) => return (all, until),
                step => panic!("{step:?}"),
            }
        }
    }

    fn serve(presence: &mut ProgramPresence, topic: &str) {
        let program = presence.offer(&service(topic)).expect("allowed");
        presence.on_served(service(topic), &program, Registered::Accepted(None));
    }

    /// Answers the query that registers the program.
    fn registered(presence: &mut ProgramPresence, now: Instant) {
        let reply = Ok(Sample {
            key: String::new(),
            payload: Payload::new("{}", Encoding::JSON),
            is_deleted: false,
            priority: Sample::PRIORITY,
            attachment: None,
        });
        let id = REGISTRATION;
        let _ = presence.on_event(now, Event::Reply { id, reply });
        let _ = presence.on_event(now, Event::Ended { id: REGISTRATION });
    }

    const TOKEN: &str = "token rect/wombat-1/@rect/p/arm/0000001f";
    const ASK: &str = "ask rect/wombat-1/@rect/@set/program";

    #[test]
    fn named_program_is_known_at_once_and_each_revision_at_most_once_a_second() {
        let (mut arm, now) = (presence(Some("arm"), false), Instant::now());
        let (first, until) = actions(&mut arm, now);
        assert_eq!(
            (first, until),
            (
                vec![ASK.to_owned(), "declare".to_owned(), format!("{TOKEN}/0")],
                None
            )
        );
        registered(&mut arm, now);
        serve(&mut arm, "grab");
        serve(&mut arm, "look");
        let later = now + BETWEEN_REVISIONS;
        assert_eq!(
            actions(&mut arm, now + BETWEEN_REVISIONS / 2),
            (vec![], Some(later))
        );
        assert_eq!(
            actions(&mut arm, later).0,
            [format!("{TOKEN}/2"), "end 0".to_owned()]
        );
        arm.on_ended(&service("grab").topic);
        // The catalogue changes before the revision that announces it.
        assert_eq!(actions(&mut arm, later), (vec![ASK.to_owned()], None));
        registered(&mut arm, later);
        assert_eq!(
            actions(&mut arm, later),
            (vec![], Some(later + BETWEEN_REVISIONS))
        );
    }

    #[test]
    fn program_without_a_name_has_a_token_while_it_serves_something() {
        let (mut program, now) = (presence(None, false), Instant::now());
        assert_eq!(
            actions(&mut program, now),
            (vec!["declare".to_owned()], None)
        );
        serve(&mut program, "grab");
        assert_eq!(
            actions(&mut program, now).0,
            ["token rect/wombat-1/@rect/p/~/0000001f/1"]
        );
        program.on_ended(&service("grab").topic);
        let later = now + BETWEEN_REVISIONS;
        assert_eq!(actions(&mut program, later).0, [ASK]);
        registered(&mut program, later);
        assert_eq!(actions(&mut program, later).0, ["end 1"]);
    }

    #[test]
    fn program_registers_again_when_its_router_is_back_and_warns_of_a_refusal() {
        let (mut arm, now) = (presence(Some("arm"), false), Instant::now());
        serve(&mut arm, "grab");
        actions(&mut arm, now);
        registered(&mut arm, now);
        let up = |up| Event::Link {
            up,
            method: "tcp".to_owned(),
            address: String::new(),
        };
        let _ = arm.on_event(now, up(false));
        assert_eq!(actions(&mut arm, now).0, Vec::<String>::new());
        let _ = arm.on_event(now, up(true));
        assert_eq!(actions(&mut arm, now).0, [ASK]);
        let reply = Err(Payload::new(
            "grab is served by the program claw already",
            Encoding::TEXT,
        ));
        let id = REGISTRATION;
        for expected in [&["grab is served by the program claw already"][..], &[]] {
            let reply = reply.clone();
            let _ = arm.on_event(now, Event::Reply { id, reply });
            assert_eq!(actions(&mut arm, now).0, expected);
        }
    }

    #[test]
    fn registration_is_repeated_until_a_router_answers() {
        let (mut arm, now) = (presence(Some("arm"), false), Instant::now());
        actions(&mut arm, now);
        let end = |arm: &mut ProgramPresence, at| {
            let _ = arm.on_event(at, Event::Ended { id: REGISTRATION });
        };
        end(&mut arm, now);
        let at = now + PAUSE;
        assert_eq!(actions(&mut arm, now), (vec![], Some(at)));
        assert_eq!(actions(&mut arm, at), (vec![ASK.to_owned()], None));
        end(&mut arm, at);
        assert_eq!(actions(&mut arm, at), (vec![], Some(at + 2 * PAUSE)));
        let at = at + 2 * PAUSE;
        assert_eq!(actions(&mut arm, at), (vec![ASK.to_owned()], None));
        registered(&mut arm, at);
        assert_eq!(actions(&mut arm, at), (vec![], None));
    }

    #[test]
    fn program_without_a_router_answers_for_itself() {
        let (mut arm, now) = (presence(Some("arm"), true), Instant::now());
        serve(&mut arm, "grab");
        actions(&mut arm, now);
        let question = Event::Query {
            id: QUERYABLE,
            query: QueryId(7),
            key: "rect/wombat-1/@rect/catalogue".to_owned(),
            payload: Payload::new("", Encoding::TEXT),
            attachment: None,
        };
        let _ = arm.on_event(now, question);
        let answer = r#"[{"program":"arm","instance":"0000001f","services":[{"topic":"grab"}]}]"#;
        assert_eq!(actions(&mut arm, now).0, [answer]);
    }

    #[test]
    fn service_that_another_program_has_taken_over_ends() {
        let (mut arm, now) = (presence(Some("arm"), false), Instant::now());
        serve(&mut arm, "grab");
        actions(&mut arm, now);
        registered(&mut arm, now);
        arm.on_taken_over(&service("grab").topic);
        let (all, _) = actions(&mut arm, now);
        assert!(all[0].contains("another one serves grab now"), "{all:?}");
        assert_eq!(all[1], ASK);
        assert_eq!(arm.program().services, []);
    }

    #[test]
    fn second_service_of_a_topic_is_refused() {
        let mut arm = presence(Some("arm"), false);
        serve(&mut arm, "grab");
        let refused = arm.offer(&service("grab")).expect_err("served already");
        assert!(
            refused.starts_with("grab is served by this program already"),
            "{refused}"
        );
        // Another thread of the program may be about to serve it.
        assert!(arm.offer(&service("look")).is_ok());
        assert!(arm.offer(&service("look")).is_err());
        arm.on_ended(&service("look").topic);
        assert!(arm.offer(&service("look")).is_ok());
    }
}
