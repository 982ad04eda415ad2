//! Drives the question which robots serve a topic, from the catalogues of all reachable robots. Those that are kept cost nothing on the air.
use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

use super::catalogue_query::{Catalogues, Revisions};
use crate::{
    catalogue::{
        read,
        token::{self, Token},
        CATALOGUE, MAX_PROGRAMS,
    },
    driver::{Action, Driver, Event, Get, Id, Reaction, Step},
    message::{payload::Payload, urgency::Qos},
    name::{key::KeySpace, topic::Topic, Name},
};

/// The timeout of each question. The robots are asked at the same time.
const TIMEOUT: Duration = Duration::from_secs(2);
/// The time within which the tokens of a program end after its queries.
const TOKENS_END_WITHIN: Duration = Duration::from_millis(250);
/// The maximum number of robots that are asked.
const MAX_ROBOTS: usize = 256;
const TOKENS: Id = Id(0);
/// The id of the question to the first robot; the next ones follow.
const FIRST: u64 = 1;

/// The programs of all robots, by the names of the robots.
type Programs = BTreeMap<Name, Revisions>;

/// The robots that serve a topic. Two answers are equal if no program has begun, ended or changed its services between them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Servers {
    /// The robots whose catalogue lists the topic. One whose catalogue does not arrive within 2 s is not among them.
    pub robots: BTreeSet<Name>,
    programs: Programs,
}

/// The question to all robots.
#[derive(Debug)]
pub struct ServersQuery {
    kept: Catalogues,
    place: KeySpace,
    topic: Topic,
    found: Servers,
    state: State,
}

#[derive(Debug)]
enum State {
    /// Asks for the tokens, at that time if there is one.
    AskTokens(Option<Instant>),
    AskingTokens,
    /// The robots to ask, those that were asked and have not answered, and how many were asked.
    Asking(Vec<Name>, BTreeMap<Id, Name>, u64),
    Closed,
}

impl Catalogues {
    /// Creates the question of a program of the robot of `place`, which robots serve `topic`.
    pub fn servers(&self, place: KeySpace, topic: Topic) -> ServersQuery {
        ServersQuery {
            kept: self.clone(),
            place,
            topic,
            found: Servers::default(),
            state: State::AskTokens(None),
        }
    }
}

impl ServersQuery {
    /// Asks a moment later, because a program may have ended at the time `now` whose token has not ended yet.
    #[must_use]
    pub fn after_end(mut self, now: Instant) -> Self {
        self.state = State::AskTokens(Some(now + TOKENS_END_WITHIN));
        self
    }

    fn on_token(&mut self, key: &str) {
        let Some(token) = Token::parse(&self.place, key) else {
            return;
        };
        let programs = &mut self.found.programs;
        if programs.len() >= MAX_ROBOTS && !programs.contains_key(&token.robot) {
            return;
        }
        let revisions = programs.entry(token.robot).or_default();
        if revisions.len() < 2 * MAX_PROGRAMS {
            revisions.insert((token.instance, token.revision));
        }
    }

    /// Reads the catalogues that are kept. Returns the robots to ask.
    fn unread(&mut self) -> Vec<Name> {
        let mut unread = Vec::new();
        let Servers { robots, programs } = &mut self.found;
        for (robot, revisions) in programs.iter() {
            // The own router answers without bytes on the air, and before the revision is announced.
            let kept = (*robot != self.place.robot).then(|| self.kept.get(robot, revisions));
            match kept.flatten() {
                Some(catalogue) if serves(&catalogue, &self.topic) => {
                    robots.insert(robot.clone());
                }
                Some(_) => {}
                None => unread.push(robot.clone()),
            }
        }
        unread
    }

    fn on_catalogue(&mut self, robot: &Name, catalogue: &Payload) {
        if serves(catalogue, &self.topic) {
            self.found.robots.insert(robot.clone());
        }
        let revisions = self.found.programs.get(robot).cloned();
        (self.kept).keep(robot, revisions.unwrap_or_default(), catalogue);
    }
}

/// Returns whether a program of a catalogue serves the topic. Invalid bytes list no services.
fn serves(catalogue: &Payload, topic: &Topic) -> bool {
    let programs = read(&catalogue.bytes).unwrap_or_default();
    programs.iter().any(|program| program.serves(topic))
}

impl Driver for ServersQuery {
    type Item = std::convert::Infallible;
    /// `None`: the session was closed.
    type Output = Option<Servers>;

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match (&mut self.state, event) {
            (state, Event::Closed) => *state = State::Closed,
            (State::AskingTokens, Event::Reply { reply, .. }) => {
                if let Ok(sample) = reply {
                    self.on_token(&sample.key);
                }
                return Reaction::NONE;
            }
            (State::AskingTokens, Event::Ended { .. }) => {
                let unread = self.unread();
                self.state = State::Asking(unread, BTreeMap::new(), FIRST);
            }
            (State::Asking(_, asked, _), Event::Reply { id, reply }) => {
                if let (Some(robot), Ok(sample)) = (asked.get(&id).cloned(), reply) {
                    self.on_catalogue(&robot, &sample.payload);
                }
                return Reaction::NONE;
            }
            (State::Asking(_, asked, _), Event::Ended { id }) => {
                asked.remove(&id);
            }
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        match &mut self.state {
            State::AskTokens(Some(at)) if now < *at => Step::Wait(Some(*at)),
            State::AskTokens(_) => {
                self.state = State::AskingTokens;
                let get = Get::liveliness(token::tokens(&self.place, None), TIMEOUT);
                Step::Act(Action::Get { id: TOKENS, get })
            }
            State::AskingTokens => Step::Wait(None),
            State::Asking(unread, asked, next) => {
                let Some(robot) = unread.pop() else {
                    return match asked.is_empty() {
                        true => Step::Finished(Some(std::mem::take(&mut self.found))),
                        false => Step::Wait(None),
                    };
                };
                let get = Get {
                    qos: Qos::REGISTRY,
                    ..Get::new(self.place.own(Some(&robot), CATALOGUE), TIMEOUT)
                };
                let id = Id(*next);
                *next += 1;
                asked.insert(id, robot);
                Step::Act(Action::Get { id, get })
            }
            State::Closed => Step::Finished(None),
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

    /// Asks who serves `grab`. Each robot answers with the services of its program, or not at all (`None`). Returns the robots, and how
    /// many were asked.
    fn ask(
        catalogues: &Catalogues,
        robots: &[(&str, u32, Option<&[&str]>)],
    ) -> (Vec<String>, usize) {
        let place = KeySpace {
            fleet: name("rect"),
            robot: name("laptop"),
        };
        let topic = Topic::new("grab").expect("valid topic");
        let (mut query, now) = (catalogues.servers(place, topic), Instant::now());
        let mut asked = 0;
        loop {
            let (id, get) = match query.poll(now) {
                Step::Act(Action::Get { id, get }) => (id, get),
                Step::Finished(found) => {
                    let found = found.expect("open session").robots;
                    return (found.iter().map(ToString::to_string).collect(), asked);
                }
                step => panic!("{step:?}"),
            };
            let sample = |key: String, text: String| Sample {
                key,
                payload: Payload::new(text, Encoding::JSON),
                is_deleted: false,
                priority: Sample::PRIORITY,
                attachment: None,
            };
            let mut reply = |sample| {
                let _ = query.on_event(
                    now,
                    Event::Reply {
                        id,
                        reply: Ok(sample),
                    },
                );
            };
            if get.liveliness {
                for (robot, revision, _) in robots {
                    let key = format!("rect/{robot}/@rect/p/arm/0000001f/{revision}");
                    reply(sample(key, String::new()));
                }
            } else {
                asked += 1;
                let of = |robot: &str| format!("rect/{robot}/@rect/catalogue") == get.selector;
                let found = robots.iter().find(|(robot, ..)| of(robot));
                if let Some((_, _, Some(topics))) = found {
                    let topics = topics
                        .iter()
                        .map(|topic| format!(r#"{{"topic":"{topic}"}}"#));
                    let services = topics.collect::<Vec<_>>().join(",");
                    let program = format!(r#"[{{"instance":"0000001f","services":[{services}]}}]"#);
                    reply(sample(get.selector, program));
                }
            }
            let _ = query.on_event(now, Event::Ended { id });
        }
    }

    #[test]
    fn robots_that_serve_the_topic_are_found_and_asked_once() {
        let catalogues = Catalogues::default();
        let (both, other): (&[&str], &[&str]) = (&["grab", "look"], &["look"]);
        let mut robots = [
            ("wombat-1", 1, Some(both)),
            ("wombat-2", 1, Some(other)),
            ("wombat-3", 1, None),
        ];
        let found = vec!["wombat-1".to_owned()];
        assert_eq!(ask(&catalogues, &robots), (found.clone(), 3));
        assert_eq!(ask(&catalogues, &robots), (found, 1));
        robots[1] = ("wombat-2", 2, Some(both));
        let found = ["wombat-1", "wombat-2"].map(str::to_owned).to_vec();
        assert_eq!(ask(&catalogues, &robots), (found, 2));
    }

    #[test]
    fn wrong_catalogues_list_no_services_and_many_robots_are_not_asked() {
        let catalogues = Catalogues::default();
        let wrong = Payload::new("{", Encoding::JSON);
        assert!(!serves(&wrong, &Topic::new("grab").expect("valid topic")));
        let names: Vec<_> = (0..2 * MAX_ROBOTS).map(|n| format!("robot-{n}")).collect();
        let robots: Vec<_> = names.iter().map(|name| (&**name, 0, None)).collect();
        assert_eq!(ask(&catalogues, &robots), (vec![], MAX_ROBOTS));
    }
}
