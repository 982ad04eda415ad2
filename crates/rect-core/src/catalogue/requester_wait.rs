//! Drives the wait of a service for the end of a requester: its program or its robot has ended.
use std::{collections::BTreeSet, time::Instant};

use super::token::{self, Token};
use crate::{
    driver::{
        ended_tokens::EndedTokens,
        question::{Next, Question},
        Action, Declaration, Driver, Event, Get, Id, Reaction, Step,
    },
    name::{instance::Instance, key::KeySpace, Name},
    session::{peers, service::Requester},
};

/// How often the tokens are asked for at once, for the reason given at [`peers::PeersQuery`].
const QUESTIONS: usize = 2;
const MAX_TOKENS: usize = 256;
const SUBSCRIBERS: [Id; 2] = [Id(0), Id(1)];
const QUERY: Id = Id(2);

/// Waits until the program or the robot of a requester has ended. Only the own router knows about it; no bytes are sent on the air.
///
/// A program without a name has no token. Then the wait is for the end of its robot.
#[derive(Debug)]
pub struct RequesterWait {
    place: KeySpace,
    robot: Name,
    /// The run of the program, if it has a token.
    run: Option<Instance>,
    /// The keys of the tokens of the robot, and those of the program.
    robots: BTreeSet<String>,
    programs: BTreeSet<String>,
    question: Question,
    ended: EndedTokens,
    subscribers: std::array::IntoIter<(Id, String), 2>,
    is_closed: bool,
}

impl RequesterWait {
    /// Creates the wait of a program of the robot of `place`. `None` if the request does not name its sender.
    pub fn new(place: KeySpace, requester: &Requester) -> Option<Self> {
        let header = requester.header.as_ref()?;
        let robot = header.sender.clone();
        let keys = [
            peers::tokens(&place, Some(&robot)),
            token::tokens(&place, Some(&robot)),
        ];
        let [of_robot, of_programs] = keys;
        let [first, second] = SUBSCRIBERS;
        Some(Self {
            place,
            robot,
            run: header.is_announced.then_some(header.id.run),
            robots: BTreeSet::new(),
            programs: BTreeSet::new(),
            question: Question::new(QUESTIONS),
            ended: EndedTokens::default(),
            subscribers: [(first, of_robot), (second, of_programs)].into_iter(),
            is_closed: false,
        })
    }

    fn on_token(&mut self, key: String, is_deleted: bool) {
        let tokens = match Token::parse(&self.place, &key) {
            Some(token) if Some(token.instance) == self.run => &mut self.programs,
            Some(_) => return,
            None => &mut self.robots,
        };
        if is_deleted {
            tokens.remove(&key);
        } else if tokens.len() < MAX_TOKENS {
            tokens.insert(key);
        }
    }

    /// Returns whether the robot is there, and the program, if that can be observed.
    fn is_present(&self) -> bool {
        !self.robots.is_empty() && (self.run.is_none() || !self.programs.is_empty())
    }
}

impl Driver for RequesterWait {
    type Item = std::convert::Infallible;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Sample { sample, .. } => {
                self.ended.on_sample(&sample.key, sample.is_deleted);
                self.on_token(sample.key, sample.is_deleted);
            }
            Event::Reply { reply, .. } => {
                if let Some(sample) = reply.ok().filter(|token| !self.ended.contains(&token.key)) {
                    self.on_token(sample.key, false);
                }
            }
            Event::Ended { .. } => {
                self.ended.on_answered();
                self.question.on_ended(now, self.is_present());
            }
            Event::Closed => self.is_closed = true,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if let Some((id, key)) = self.subscribers.next() {
            let declaration = Declaration::LivelinessSubscriber { key };
            return Step::Act(Action::Declare { id, declaration });
        }
        match self.question.next(now) {
            Next::Ask => {
                self.ended.on_asked();
                let tokens = self.place.own(Some(&self.robot), "**");
                let get = Get::liveliness(tokens, peers::TIMEOUT);
                Step::Act(Action::Get { id: QUERY, get })
            }
            Next::At(at) => Step::Wait(Some(at)),
            Next::Finish if !self.is_present() => Step::Finished(()),
            Next::Wait | Next::Finish => Step::Wait(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    use crate::{
        driver::Sample,
        message::{encoding::Encoding, payload::Payload},
        session::request_ids::RequestIds,
    };

    const ALIVE: &str = "rect/wombat-1/@rect/alive/a1";
    const PROGRAM: &str = "rect/wombat-1/@rect/p/arm/0000001f/0";
    const NEXT: &str = "rect/wombat-1/@rect/p/arm/0000001f/1";
    const OTHER: &str = "rect/wombat-1/@rect/p/arm/0000002f/0";

    fn place(robot: &str) -> KeySpace {
        let name = |text: &str| Name::new(text).expect("valid name");
        KeySpace {
            fleet: name("rect"),
            robot: name(robot),
        }
    }

    fn wait(is_announced: bool) -> RequesterWait {
        let ids = RequestIds::new(Instance(0x1f), is_announced);
        let header = Some(ids.header(&place("wombat-1"), Duration::from_secs(1)));
        RequesterWait::new(place("wombat-2"), &Requester { header }).expect("it names its sender")
    }

    /// Answers the questions with these tokens. Returns whether the wait has ended.
    fn is_finished(wait: &mut RequesterWait, tokens: &[&str]) -> bool {
        let mut now = Instant::now();
        loop {
            match wait.poll(now) {
                Step::Act(Action::Get { id, .. }) => {
                    for token in tokens {
                        let reply = Ok(sample(token, false));
                        let _ = wait.on_event(now, Event::Reply { id, reply });
                    }
                    let _ = wait.on_event(now, Event::Ended { id });
                }
                Step::Act(_) => {}
                Step::Wait(Some(at)) => now = at,
                Step::Wait(None) => return false,
                Step::Finished(()) => return true,
                Step::Deliver(never) => match never {},
            }
        }
    }

    fn sample(key: &str, is_deleted: bool) -> Sample {
        Sample {
            key: key.to_owned(),
            payload: Payload::new("", Encoding::BYTES),
            attachment: None,
            is_deleted,
            priority: Sample::PRIORITY,
        }
    }

    #[test]
    fn wait_ends_with_the_program_or_the_robot() {
        for (is_announced, tokens, is_present) in [
            (true, &[ALIVE, PROGRAM][..], true),
            (true, &[ALIVE, OTHER], false),
            (true, &[ALIVE], false),
            (false, &[ALIVE, OTHER], true),
            (false, &[], false),
        ] {
            let mut wait = wait(is_announced);
            assert_eq!(is_finished(&mut wait, tokens), !is_present, "{tokens:?}");
        }
    }

    #[test]
    fn reply_about_a_token_that_has_ended_meanwhile_counts_for_nothing() {
        let (mut wait, now) = (wait(true), Instant::now());
        while !matches!(wait.poll(now), Step::Act(Action::Get { .. })) {}
        for (key, is_deleted) in [(ALIVE, false), (PROGRAM, false), (PROGRAM, true)] {
            let (id, sample) = (SUBSCRIBERS[1], sample(key, is_deleted));
            let _ = wait.on_event(now, Event::Sample { id, sample });
        }
        let reply = Ok(sample(PROGRAM, false));
        let _ = wait.on_event(now, Event::Reply { id: QUERY, reply });
        let _ = wait.on_event(now, Event::Ended { id: QUERY });
        assert!(is_finished(&mut wait, &[ALIVE]));
    }

    #[test]
    fn new_revision_of_the_program_is_not_its_end() {
        let mut wait = wait(true);
        assert!(!is_finished(&mut wait, &[ALIVE, PROGRAM]));
        let now = Instant::now();
        for (key, is_deleted, ends) in [
            (NEXT, false, false),
            (PROGRAM, true, false),
            (NEXT, true, true),
        ] {
            let sample = sample(key, is_deleted);
            let id = SUBSCRIBERS[1];
            let _ = wait.on_event(now, Event::Sample { id, sample });
            assert_eq!(is_finished(&mut wait, &[]), ends, "{key}");
        }
    }
}
