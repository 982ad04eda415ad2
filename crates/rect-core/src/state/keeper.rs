//! Drives the state of a robot, for its router or for a program without one: keeps the values of its programs, has copies of those of other
//! robots, and answers everybody who asks.
mod orders;
mod routers;

use std::{
    collections::{BTreeMap, VecDeque},
    fmt,
    time::{Duration, Instant},
};

use bytes::Bytes;
use zenoh_keyexpr::OwnedKeyExpr;

use super::{
    copies::{Copied, Copies},
    followers::Followers,
    page::{checked, read, selects, write, Page},
    polls::Polls,
    saved::Saved,
    store::{is_selected, zenoh_key, Entry, Key, Store},
    Position, GRACE, OF_PROGRAMS, STATE, TOKEN,
};
use crate::{
    catalogue::token::{self, Token},
    driver::{
        Action, Answer, Declaration, Driver, Event, Id, QueryId, Reaction, RetainedReply, Sample,
        Step,
    },
    message::{encoding::Encoding, payload::Payload, request::RequestHeader, Message},
    name::{key::KeySpace, topic::Topic, Name},
    registry::topics::RetainedTopic,
};

/// The timeout of a question to another router.
const TIMEOUT: Duration = Duration::from_secs(10);
/// The maximum number of changes that wait to be sent.
const MAX_ACTIONS: usize = 4096;

const OF_PROGRAMS_ID: Id = Id(0);
const OF_ROUTERS: Id = Id(1);
const OF_TOOLS: Id = Id(2);
const OF_ADVANCED: Id = Id(3);
const TOKEN_ID: Id = Id(4);
const TOKENS: Id = Id(5);
const PRESENCE: Id = Id(6);
const PROGRAMS: Id = Id(7);
/// The ids of questions and subscriptions follow this one.
const FIRST: u64 = 16;

/// The position of a robot whose router keeps no values.
const NOWHERE: Position = Position(0, 0);

/// Something for the one who runs the driver.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Item {
    /// Write these bytes to disk, in place of those before.
    Save(Vec<u8>),
    /// A problem that its user should know.
    Warning(String),
}

/// Returns whether a program serves a topic, which then cannot be state.
pub type IsServed = Box<dyn Fn(&Topic) -> bool + Send>;

/// Returns the time of day in milliseconds since 1970. Only the ages of values on disk depend on it.
pub type TimeOfDay = Box<dyn Fn() -> u64 + Send>;

/// The state of a robot.
pub struct StateKeeper {
    place: KeySpace,
    run: u32,
    store: Store,
    polls: Polls,
    copies: Copies,
    followers: Followers,
    is_served: IsServed,
    time_of_day: TimeOfDay,
    /// The topics of other robots that programs subscribe to.
    interests: Vec<OwnedKeyExpr>,
    /// The subscriptions to them.
    subscriptions: Vec<(OwnedKeyExpr, Id)>,
    /// The programs of this robot that have a token, and how many.
    programs: BTreeMap<u32, usize>,
    /// Until when the programs may give it values that it has lost.
    grace: Option<Instant>,
    /// The own number since which values that are not there are forgotten.
    complete_at: u64,
    /// Whether it observes the routers of other robots.
    is_observing: bool,
    is_open: bool,
    is_announced: bool,
    /// The last id of a question or a subscription.
    last_id: u64,
    actions: VecDeque<Action>,
    items: VecDeque<Item>,
    is_warned: bool,
    /// Why values are not on disk that should be.
    not_on_disk: Option<String>,
    is_without_disk: bool,
    is_closed: bool,
}

/// Whether and where values are kept on disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Disk {
    /// There is no place for them, for this reason.
    None(String),
    /// The bytes of the last [`Item::Save`], if there are any.
    Saved(Option<Vec<u8>>),
}

impl fmt::Debug for StateKeeper {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "StateKeeper({}, {:08x})", self.place.robot, self.run)
    }
}

impl StateKeeper {
    /// Creates the state of the robot of `place`. `run` is a random number.
    pub fn new(
        place: KeySpace,
        run: u32,
        disk: Disk,
        is_served: IsServed,
        time_of_day: TimeOfDay,
        now: Instant,
    ) -> Self {
        let key = place.own(Some(&place.robot), OF_PROGRAMS);
        let complete = true;
        let declaration = Declaration::Queryable { key, complete };
        let of_own = Declaration::LivelinessSubscriber {
            key: token::tokens(&place, Some(&place.robot)),
        };
        let declared = [(OF_PROGRAMS_ID, declaration), (PROGRAMS, of_own)];
        let declared = declared.map(|(id, declaration)| Action::Declare { id, declaration });
        let mut keeper = Self {
            place,
            run,
            store: Store::default(),
            polls: Polls::default(),
            copies: Copies::default(),
            followers: Followers::default(),
            is_served,
            time_of_day,
            interests: Vec::new(),
            subscriptions: Vec::new(),
            programs: BTreeMap::new(),
            grace: Some(now + GRACE),
            complete_at: 0,
            is_observing: false,
            is_open: false,
            is_announced: false,
            last_id: FIRST,
            actions: declared.into(),
            items: VecDeque::new(),
            is_warned: false,
            not_on_disk: None,
            is_without_disk: matches!(disk, Disk::None(_)),
            is_closed: false,
        };
        match disk {
            Disk::None(reason) => keeper.not_on_disk = Some(reason),
            Disk::Saved(Some(saved)) => keeper.load(&saved, now),
            Disk::Saved(None) => {}
        }
        keeper
    }

    /// Creates the state of the robot of a program that has no router.
    pub fn of_program(place: KeySpace, run: u32, now: Instant) -> Self {
        let disk = Disk::None("a program without a router keeps no values on disk".to_owned());
        Self::new(place, run, disk, Box::new(|_| false), Box::new(|| 0), now)
    }

    /// Returns whether a topic of this robot has a value, so that no program can serve it.
    pub fn has(&self, topic: &Topic) -> bool {
        let key = (self.place.robot.clone(), topic.clone());
        let entry = self.store.get(&key);
        entry.is_some_and(|entry| entry.payload.is_some())
    }

    /// Returns the retained topics of this robot, in the order of their names.
    pub fn topics(&self) -> Vec<RetainedTopic> {
        let own = self.store.of(&self.place.robot);
        let topics = own.filter_map(|((_, topic), entry)| {
            let payload = entry.payload.as_ref()?;
            Some(RetainedTopic {
                topic: topic.to_string(),
                encoding: payload.encoding.as_str().to_owned(),
                bytes: payload.bytes.len() as u64,
            })
        });
        topics.collect()
    }

    /// Returns the last messages of the retained topics of this robot, in the order of their names.
    pub fn messages(&self, now: Instant) -> Vec<Message> {
        let own = &self.place.robot;
        let values = self
            .store
            .of(own)
            .map(|(key, entry)| entry.value(key, own, now));
        values.map(|value| value.message(own.clone())).collect()
    }

    /// Handles that bytes could not be written to disk, or were.
    pub fn on_saved(&mut self, error: Option<String>) {
        let text = |error| {
            format!("the retained values cannot be written to disk, and are lost when this router ends: {error}")
        };
        let was_known = self.not_on_disk.is_some();
        self.not_on_disk = error.map(text);
        if let Some(text) = self.not_on_disk.clone().filter(|_| !was_known) {
            self.items.push_back(Item::Warning(text));
        }
    }

    fn warn(&mut self, text: String) {
        if !self.is_warned {
            self.items.push_back(Item::Warning(text));
        }
    }

    fn load(&mut self, saved: &[u8], now: Instant) {
        let saved = match Saved::decode(saved, (self.time_of_day)()) {
            Ok(saved) => saved,
            Err(error) => {
                return self.warn(format!(
                    "the file of the retained values is damaged, and is replaced: {error}"
                ));
            }
        };
        for value in saved.records {
            let key = (self.place.robot.clone(), value.topic.clone());
            let kept = Some(Position(saved.run, value.number));
            let entry = Entry {
                disk: true,
                is_loaded: true,
                has_ended: true,
                ..Entry::of(value, kept, now)
            };
            // The limits may be smaller than those with which it was written.
            let _ = self.store.put(key, entry);
        }
        self.announce();
    }

    fn saved(&self, now: Instant) -> Vec<u8> {
        let own = &self.place.robot;
        let kept = self.store.of(own);
        let kept = kept.filter(|(_, entry)| entry.disk && entry.payload.is_some());
        let saved = Saved {
            run: self.run,
            at_ms: (self.time_of_day)(),
            records: kept
                .map(|(key, entry)| entry.value(key, own, now))
                .collect(),
        };
        saved.encode()
    }

    fn id(&mut self) -> Id {
        next_id(&mut self.last_id)
    }

    fn declare(&mut self, id: Id, declaration: Declaration) {
        self.actions.push_back(Action::Declare { id, declaration });
    }

    fn answer(&mut self, query: QueryId, key: &str, payload: Payload) {
        let key = self.place.own(Some(&self.place.robot), key);
        let answer = Answer::Reply { key, payload };
        self.actions.push_back(Action::Answer { query, answer });
    }

    fn refuse(&mut self, query: QueryId, reason: impl fmt::Display) {
        let answer = Answer::Error(Payload::new(reason.to_string(), Encoding::TEXT));
        self.actions.push_back(Action::Answer { query, answer });
    }

    fn end(&mut self, query: QueryId) {
        let answer = Answer::None;
        self.actions.push_back(Action::Answer { query, answer });
    }

    /// Answers other routers from now on.
    fn open(&mut self) {
        if !std::mem::replace(&mut self.is_open, true) {
            let key = self.place.own(Some(&self.place.robot), STATE);
            let complete = true;
            self.declare(OF_ROUTERS, Declaration::Queryable { key, complete });
        }
    }

    /// Shows everybody that there are values.
    fn announce(&mut self) {
        if std::mem::replace(&mut self.is_announced, true) {
            return;
        }
        self.open();
        let KeySpace { fleet, robot } = &self.place;
        let tools = format!("{fleet}/{robot}/**");
        let advanced = format!("{fleet}/{robot}/**/@adv/**");
        let key = (self.place).own(Some(robot), &format!("{TOKEN}/{:08x}", self.run));
        // zenoh-ext asks only once. A tool that gets an answer from the other one can rely on this one.
        for (id, key) in [(OF_ADVANCED, advanced), (OF_TOOLS, tools)] {
            let complete = false;
            self.declare(id, Declaration::Queryable { key, complete });
        }
        // The last one: a router that sees it can ask.
        self.declare(TOKEN_ID, Declaration::LivelinessToken { key });
    }

    fn on_change(&mut self, key: &Key, now: Instant) {
        let key = zenoh_key(&self.place.fleet, key);
        self.followers.on_change(now, |keys| selects(keys, &key));
    }

    /// Returns a page for programs of this robot.
    pub(super) fn page(
        &self,
        since: Option<Position>,
        keys: &[OwnedKeyExpr],
        now: Instant,
        is_own: bool,
    ) -> Page {
        let KeySpace { fleet, robot: own } = &self.place;
        let select = |key: &Key| (!is_own || key.0 == *own) && is_selected(fleet, keys, key);
        let mut page = self.store.page(self.run, since, own, now, select);
        if page.more {
            return page;
        }
        let since = since.filter(|Position(run, _)| *run == self.run);
        let is_new = |at: u64| since.is_none_or(|Position(_, number)| at > number);
        if self.grace.is_none() && (is_own || is_new(self.complete_at)) {
            let at = Position(self.run, self.store.last());
            page.complete.push((String::new(), at));
        }
        if !is_own {
            let others = self.copies.all().filter(|(robot, copied)| {
                let is_known = copied.is_complete && copied.covers(fleet, robot, keys);
                is_new(copied.complete_at) && (is_known || copied.is_empty)
            });
            let complete = |(robot, copied): (&Name, &Copied)| {
                let at = match copied.is_empty {
                    true => Some(NOWHERE),
                    false => copied.position(),
                };
                at.map(|at| (robot.to_string(), at))
            };
            page.complete.extend(others.filter_map(complete));
        }
        page
    }

    /// Answers the programs for which there is something new.
    fn answer_polls(&mut self, now: Instant) {
        let last = Position(self.run, self.store.last());
        let pages = self.polls.open().filter_map(|(program, poll)| {
            if poll.since == Some(last) {
                return None;
            }
            let page = self.page(poll.since, &poll.keys, now, false);
            let is_same_run = poll.since.is_some_and(|Position(run, _)| run == self.run);
            let has_news = !page.records.is_empty() || !page.complete.is_empty() || !is_same_run;
            Some((program, has_news.then_some(page)))
        });
        let pages: Vec<_> = pages.collect();
        for (program, page) in pages {
            let Some(page) = page else {
                self.polls.on_nothing_new(program, last);
                continue;
            };
            if let Some(query) = self.polls.take(program, now) {
                self.answer(query, OF_PROGRAMS, write(&page));
            }
        }
    }

    /// Answers a tool that does not use RECT with the values of the topics that it asks for.
    fn on_get(&mut self, query: QueryId, asked: &str, is_request: bool) {
        let asked = match asked.split_once("/@adv") {
            Some((topics, _)) => topics,
            None => asked,
        };
        let keys = checked(vec![asked.to_owned()], 1).unwrap_or_default();
        let own = self.store.of(&self.place.robot);
        let fleet = &self.place.fleet;
        let selected = own.filter(|(key, _)| !is_request && is_selected(fleet, &keys, key));
        let replies = selected.filter_map(|(key, entry)| {
            Some(RetainedReply {
                key: zenoh_key(fleet, key),
                payload: entry.payload.clone()?,
                attachment: entry.attachment(self.run),
                number: entry.number as u32,
            })
        });
        let replies = replies.collect();
        (self.actions).push_back(Action::AnswerRetained { query, replies });
    }

    /// Handles a token of a program of this robot.
    fn on_program(&mut self, token: &Token, is_up: bool, now: Instant) {
        let Token { instance, .. } = token;
        let tokens = self.programs.entry(instance.0).or_default();
        match is_up {
            true => *tokens += 1,
            false => *tokens = tokens.saturating_sub(1),
        }
        if *tokens == 0 {
            self.programs.remove(&instance.0);
            if let Some(query) = self.polls.on_ended(instance.0, now) {
                self.end(query);
            }
            self.subscribe();
            self.mark_ended(instance.0, now);
        }
    }

    fn mark_ended(&mut self, program: u32, now: Instant) {
        for key in self.mark_program(program, true) {
            self.on_change(&key, now);
        }
    }

    /// Marks whether the program of values has ended. Returns those that have changed.
    fn mark_program(&mut self, program: u32, has_ended: bool) -> Vec<Key> {
        let is_marked = |entry: &Entry| entry.origin.0 == program && entry.has_ended != has_ended;
        let of_program = self.store.of(&self.place.robot);
        let of_program =
            of_program.filter(|(_, entry)| is_marked(entry) && entry.payload.is_some());
        let keys: Vec<_> = of_program.map(|(key, _)| key.clone()).collect();
        for key in &keys {
            self.store
                .update(key, true, |entry| entry.has_ended = has_ended);
        }
        keys
    }

    fn on_sample(&mut self, id: Id, sample: Sample, now: Instant) {
        let is_up = !sample.is_deleted;
        match id {
            TOKENS => {
                let robot = self.place.robot_of(&sample.key);
                let run = sample.key.rsplit('/').next();
                let run = run.and_then(|run| u32::from_str_radix(run, 16).ok());
                if let (Some(robot), Some(run)) = (robot, run) {
                    if robot != self.place.robot {
                        if is_up {
                            // Its router asks whether this one has its values.
                            self.open();
                        }
                        self.copies.on_token(&robot, run, is_up, now);
                        self.subscribe();
                    }
                }
            }
            PRESENCE => {
                if let Some(robot) = self.place.robot_of(&sample.key) {
                    if robot != self.place.robot {
                        self.copies.on_presence(&robot, is_up, now);
                    }
                }
            }
            PROGRAMS => {
                if let Some(token) = Token::parse(&self.place, &sample.key) {
                    self.on_program(&token, is_up, now);
                }
            }
            _ => self.on_live(sample, now),
        }
    }

    /// Does what is due at this time.
    fn on_time(&mut self, now: Instant) {
        if self.grace.is_some_and(|until| until <= now) {
            self.grace = None;
            self.complete_at = self.store.bump();
            self.followers.on_change(now, |_| true);
        }
        let (open, gone) = self.polls.due(now);
        for program in open {
            if let Some(query) = self.polls.take(program, now) {
                self.end(query);
            }
        }
        for program in &gone {
            if !self.programs.contains_key(program) {
                self.mark_ended(*program, now);
            }
        }
        if !gone.is_empty() {
            self.on_interests();
        }
        for robot in self.copies.emptied(now) {
            self.on_emptied(&robot);
        }
        self.answer_polls(now);
        self.ask(now);
    }

    fn wait(&self) -> Option<Instant> {
        let times = [
            self.grace
                .filter(|_| self.is_announced || self.is_open || !self.interests.is_empty()),
            self.polls.next(),
            self.followers.next(),
            self.copies.next(),
        ];
        times.into_iter().flatten().min()
    }
}

/// Returns an id that was not used yet.
fn next_id(last: &mut u64) -> Id {
    *last += 1;
    Id(*last)
}

impl Driver for StateKeeper {
    type Item = Item;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Item> {
        match event {
            Event::Query {
                id,
                query,
                key,
                payload,
                attachment,
            } => {
                if self.actions.len() >= MAX_ACTIONS {
                    self.end(query);
                    return Reaction::POLL;
                }
                match id {
                    OF_PROGRAMS_ID => self.on_order(query, &payload, now),
                    OF_ROUTERS => self.on_question(query, &payload, now),
                    _ => {
                        let is_request = attachment
                            .is_some_and(|bytes: Bytes| RequestHeader::decode(&bytes).is_some());
                        self.on_get(query, &key, is_request);
                    }
                }
            }
            Event::Sample { id, sample } => self.on_sample(id, sample, now),
            Event::Reply { id, reply } => {
                if let Ok(sample) = reply {
                    match self.copies.asked(id).is_some() {
                        true => self.on_page(id, &sample.payload, now),
                        false => {
                            let is_followed = read(&sample.payload.bytes).unwrap_or(true);
                            self.followers.on_answer(id, !is_followed);
                        }
                    }
                }
            }
            Event::Ended { id } => {
                self.followers.on_ended(id, now);
                let more = self.copies.on_ended(id, &self.place.robot, now);
                if let Some((robot, question)) = more {
                    self.get(id, &robot, &question);
                }
            }
            Event::Closed => self.is_closed = true,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Item, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if self.actions.is_empty() {
            self.on_time(now);
        }
        if let Some(item) = self.items.pop_front() {
            return Step::Deliver(item);
        }
        match self.actions.pop_front() {
            Some(action) => Step::Act(action),
            None => Step::Wait(self.wait()),
        }
    }
}
