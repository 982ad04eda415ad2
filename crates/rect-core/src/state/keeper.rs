//! Drives the state of a robot, for its router or for a program without one: keeps the values of its programs, has copies of those of other
//! robots, and answers everybody who asks.
use std::{
    collections::{BTreeMap, VecDeque},
    fmt,
    time::{Duration, Instant},
};

use bytes::Bytes;
use zenoh_keyexpr::OwnedKeyExpr;

use super::{
    copies::{is_of, Copied, Copies},
    followers::Followers,
    page::{
        checked, read, selects, write, Kept, Order, Page, Question, MAX_KEYS, MAX_KEYS_OF_PROGRAM,
    },
    polls::Polls,
    store::{is_selected, zenoh_key, Entry, Full, Key, Store},
    Origin, Position, BULK, GRACE, OF_PROGRAMS, STATE, TOKEN,
};
use crate::{
    catalogue::token::{self, Token},
    driver::{
        Action, Answer, Declaration, Driver, Event, Get, Id, QueryId, Reaction, RetainedReply,
        Sample, Step,
    },
    message::{
        encoding::Encoding,
        payload::Payload,
        request::RequestHeader,
        retained::{live::Live, value::Value},
        urgency::{Qos, Urgency},
    },
    name::{key::KeySpace, topic::Topic, Name},
    registry::topics::RetainedTopic,
    session::peers,
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
/// The id of the first question or subscription; the next ones follow.
const FIRST: u64 = 16;

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

/// The state of a robot.
pub struct StateKeeper {
    place: KeySpace,
    run: u32,
    store: Store,
    polls: Polls,
    copies: Copies,
    followers: Followers,
    is_served: IsServed,
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
    next: u64,
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
    pub fn new(place: KeySpace, run: u32, disk: Disk, is_served: IsServed, now: Instant) -> Self {
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
            interests: Vec::new(),
            subscriptions: Vec::new(),
            programs: BTreeMap::new(),
            grace: Some(now + GRACE),
            complete_at: 0,
            is_observing: false,
            is_open: false,
            is_announced: false,
            next: FIRST,
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
        let page: Page = match read(saved) {
            Ok(page) => page,
            Err(error) => {
                return self.warn(format!(
                    "the file of the retained values is damaged, and is replaced: {error}"
                ));
            }
        };
        for value in page.records {
            let key = (self.place.robot.clone(), value.topic.clone());
            let kept = Some(Position(page.run, value.number));
            let entry = Entry {
                disk: true,
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
        let page = Page {
            run: self.run,
            records: kept
                .map(|(key, entry)| entry.value(key, own, now))
                .collect(),
            ..Page::default()
        };
        write(&page).bytes.to_vec()
    }

    fn id(&mut self) -> Id {
        self.next += 1;
        Id(self.next)
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
        for (id, key) in [(OF_TOOLS, tools), (OF_ADVANCED, advanced)] {
            let complete = false;
            self.declare(id, Declaration::Queryable { key, complete });
        }
        // The last one: a router that sees it can ask.
        self.declare(TOKEN_ID, Declaration::LivelinessToken { key });
    }

    fn on_order(&mut self, query: QueryId, payload: &Payload, now: Instant) {
        let order: Order = match read(&payload.bytes) {
            Ok(order) => order,
            Err(error) => return self.refuse(query, error),
        };
        match order {
            Order::Poll {
                program,
                since,
                keys,
            } => match checked(keys, MAX_KEYS_OF_PROGRAM) {
                Ok(keys) => {
                    let replaced = self.polls.add(program, query, since, keys, now);
                    replaced.into_iter().for_each(|query| self.end(query));
                    self.mark_program(program, false);
                    self.on_interests();
                }
                Err(error) => self.refuse(query, error),
            },
            Order::Latest { key } => match checked(vec![key], 1) {
                Ok(keys) => {
                    let page = self.page(None, &keys, now, false);
                    self.answer(query, OF_PROGRAMS, write(&page));
                }
                Err(error) => self.refuse(query, error),
            },
            Order::Set { ref topic, .. } | Order::Forget { ref topic, .. } => {
                match Topic::new(topic) {
                    Ok(topic) => match self.set(topic, order, now) {
                        Ok(kept) => self.answer(query, OF_PROGRAMS, write(&kept)),
                        Err(reason) => self.refuse(query, reason),
                    },
                    Err(error) => self.refuse(query, error),
                }
            }
        }
    }

    /// Keeps a value of a program, or forgets one, and publishes that.
    fn set(&mut self, topic: Topic, order: Order, now: Instant) -> Result<Kept, String> {
        if (self.is_served)(&topic) {
            return Err(format!(
                "a program of this robot serves {topic}, and a topic cannot be served and retained: choose another topic"
            ));
        }
        let key = (self.place.robot.clone(), topic);
        let existing = self.store.get(&key);
        let (entry, is_restored) = match order {
            Order::Set {
                origin,
                sent_ms,
                kept,
                age_ms,
                urgency,
                disk,
                encoding,
                bytes,
                ..
            } => {
                let encoding = Encoding::new(encoding);
                encoding.check_length().map_err(|error| error.to_string())?;
                let entry = Entry {
                    number: 0,
                    origin,
                    payload: Some(Payload::new(bytes, encoding)),
                    urgency,
                    sent_ms,
                    since: super::store::before(now, Duration::from_millis(age_ms)),
                    has_ended: false,
                    kept,
                    disk,
                };
                (entry, kept.is_some())
            }
            Order::Forget {
                origin, sent_ms, ..
            } => {
                let entry = Entry {
                    number: 0,
                    origin,
                    payload: None,
                    urgency: Urgency::Normal,
                    sent_ms,
                    since: now,
                    has_ended: false,
                    kept: None,
                    disk: false,
                };
                (entry, false)
            }
            Order::Poll { .. } | Order::Latest { .. } => return Err("no value".to_owned()),
        };
        let kept = |number| Kept {
            at: Position(self.run, number),
            warning: None,
        };
        if let Some(existing) = existing {
            // It was repeated because the reply was lost, or the program comes back.
            if existing.origin == entry.origin {
                let kept = kept(existing.number);
                let has_ended = existing.has_ended;
                self.store
                    .update(&key, has_ended, |existing| existing.has_ended = false);
                return Ok(kept);
            }
            if is_restored && is_newer(existing.kept, entry.kept) {
                return Ok(kept(existing.number));
            }
        }
        let had_value = existing.is_some_and(|existing| existing.payload.is_some());
        if !self.programs.contains_key(&entry.origin.0) {
            self.polls.expect(entry.origin.0, now);
        }
        if entry.payload.is_none() && !had_value {
            return Ok(kept(self.store.last()));
        }
        let was_on_disk = existing.is_some_and(|existing| existing.disk);
        let is_on_disk = entry.disk || was_on_disk;
        let published = Published::of(&entry);
        let warning = self.not_on_disk.clone().filter(|_| entry.disk);
        match self.store.put(key.clone(), entry) {
            Ok(number) => {
                if is_on_disk && !self.is_without_disk {
                    // Before it is published: after a crash, nobody gets an older value than others had.
                    self.items.push_back(Item::Save(self.saved(now)));
                }
                if !is_restored {
                    self.publish(&key, number, published);
                }
                self.announce();
                self.on_change(&key, now);
                Ok(Kept {
                    at: Position(self.run, number),
                    warning,
                })
            }
            Err(full) => {
                if let (false, Some(payload)) = (is_restored, published.payload) {
                    self.actions.push_back(Action::PutOnce {
                        key: zenoh_key(&self.place.fleet, &key),
                        payload,
                        qos: published.qos,
                    });
                }
                Err(full.to_string())
            }
        }
    }

    fn publish(&mut self, key: &Key, number: u64, published: Published) {
        let live = Live {
            position: Position(self.run, number),
            origin: published.origin,
            sent_ms: published.sent_ms,
            urgency: published.urgency,
        };
        self.actions.push_back(Action::PutRetained {
            key: zenoh_key(&self.place.fleet, key),
            payload: published.payload,
            qos: published.qos,
            attachment: live.encode(),
            number: number as u32,
        });
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
                copied.is_complete
                    && is_new(copied.complete_at)
                    && copied.covers(fleet, robot, keys)
            });
            let complete = |(robot, copied): (&Name, &Copied)| {
                copied.position().map(|at| (robot.to_string(), at))
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

    /// Handles that the programs may subscribe to other topics than before.
    fn on_interests(&mut self) {
        let KeySpace { fleet, robot } = &self.place;
        let own = format!("{fleet}/{robot}/");
        // The values of this robot are not copies.
        let is_of_others = |key: &OwnedKeyExpr| !key.as_str().starts_with(&own);
        let interests = self.polls.interests().into_iter().filter(is_of_others);
        let mut interests: Vec<_> = interests.collect();
        if interests.len() > MAX_KEYS {
            let all = OwnedKeyExpr::autocanonize(format!("{fleet}/*/**"));
            interests = all.into_iter().collect();
        }
        if interests == self.interests {
            return;
        }
        self.interests = interests;
        if !self.interests.is_empty() && !self.is_observing {
            self.is_observing = true;
            let key = self.place.own(None, &format!("{TOKEN}/*"));
            self.declare(TOKENS, Declaration::LivelinessSubscriber { key });
            let key = peers::tokens(&self.place, None);
            self.declare(PRESENCE, Declaration::LivelinessSubscriber { key });
        }
        self.copies.on_interests(&self.interests);
        self.drop_copies();
        self.subscribe();
    }

    /// Subscribes to the topics that programs subscribe to, of each robot that keeps values. A subscription to those of all robots would
    /// also match the publishers of this one, which then had a subscriber.
    fn subscribe(&mut self) {
        let fleet = &self.place.fleet;
        let robots = self.copies.keeping();
        let keys = robots.flat_map(|robot| {
            let of_robot = self.interests.iter().filter(|key| is_of(fleet, robot, key));
            of_robot.filter_map(|key| of(fleet, robot, key))
        });
        let mut keys: Vec<_> = keys.collect();
        keys.sort_by(|a, b| a.as_str().cmp(b.as_str()));
        keys.dedup();
        let (kept, removed): (Vec<_>, Vec<_>) = std::mem::take(&mut self.subscriptions)
            .into_iter()
            .partition(|(key, _)| keys.contains(key));
        self.subscriptions = kept;
        let undeclare = |(_, id)| Action::Undeclare { id };
        self.actions.extend(removed.into_iter().map(undeclare));
        for key in keys {
            if !self.subscriptions.iter().any(|(known, _)| *known == key) {
                let id = self.id();
                let text = key.to_string();
                self.declare(id, Declaration::Subscriber { key: text });
                self.subscriptions.push((key, id));
            }
        }
    }

    /// Removes the copies that no program subscribes to.
    fn drop_copies(&mut self) {
        let (fleet, interests) = (&self.place.fleet, &self.interests);
        let robots: Vec<_> = self.copies.all().map(|(robot, _)| robot.clone()).collect();
        for robot in robots {
            let of_robot = self.store.of(&robot).map(|(key, _)| key);
            let unused = of_robot.filter(|key| !is_selected(fleet, interests, key));
            for key in unused.cloned().collect::<Vec<_>>() {
                self.store.remove(&key);
            }
        }
    }

    /// Handles a question of another router.
    fn on_question(&mut self, query: QueryId, payload: &Payload, now: Instant) {
        let own = self.place.robot.clone();
        match read(&payload.bytes) {
            Ok(Question::Since {
                by,
                adds,
                since,
                keys,
            }) => match checked(keys, MAX_KEYS) {
                Ok(keys) => {
                    let page = self.page(since, &keys, now, true);
                    if let Some(by) = by.and_then(|by| Name::new(&by).ok()) {
                        self.followers.add(by, keys, adds);
                    }
                    self.answer(query, STATE, write(&page));
                }
                Err(error) => self.refuse(query, error),
            },
            Ok(Question::Check {
                of,
                at,
                digest,
                is_complete,
            }) => {
                let fleet = &self.place.fleet;
                let of = Name::new(&of).ok().filter(|of| *of != own);
                let is_followed = of
                    .as_ref()
                    .is_some_and(|of| self.interests.iter().any(|key| is_of(fleet, of, key)));
                if let Some(of) = of.filter(|_| is_followed) {
                    let known = self.copies.get(&of).map_or(0, |copied| {
                        let select = |key: &Key| is_selected(fleet, copied.fetched(), key);
                        self.store.digest(&of, Some(at.0), select)
                    });
                    if let Some(copied) = self.copies.get_mut(&of) {
                        let is_same = copied
                            .position()
                            .is_some_and(|Position(run, _)| run == at.0);
                        match is_same && known == digest && copied.is_complete == is_complete {
                            true => copied.on_known(at),
                            false => copied.on_behind(),
                        }
                    }
                }
                self.answer(query, STATE, write(&is_followed));
            }
            Err(error) => self.refuse(query, error),
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
            let live = Live {
                position: Position(self.run, entry.number),
                origin: entry.origin,
                sent_ms: entry.sent_ms,
                urgency: entry.urgency,
            };
            Some(RetainedReply {
                key: zenoh_key(fleet, key),
                payload: entry.payload.clone()?,
                attachment: live.encode(),
                number: entry.number as u32,
            })
        });
        let replies = replies.collect();
        (self.actions).push_back(Action::AnswerRetained { query, replies });
    }

    /// Handles a value that another robot has published.
    fn on_live(&mut self, sample: Sample, now: Instant) {
        let live = sample.attachment.as_deref().and_then(Live::decode);
        let (Some(live), Ok(address)) = (live, self.place.parse(&sample.key)) else {
            return;
        };
        let robot = address.sender;
        if robot == self.place.robot || address.recipient.is_some() {
            return;
        }
        let Some(copied) = self.copies.get_mut(&robot) else {
            return;
        };
        if copied
            .position()
            .is_none_or(|Position(run, _)| run != live.position.0)
        {
            // It may be older than what the router answers.
            return copied.on_behind();
        }
        let value = Value {
            robot: None,
            topic: address.topic,
            number: live.position.1,
            origin: live.origin,
            is_forgotten: sample.is_deleted,
            payload: sample.payload,
            urgency: live.urgency,
            sent_ms: live.sent_ms,
            age: Duration::ZERO,
            has_ended: false,
            kept: None,
        };
        self.copy(&robot, value, live.position.0, now);
    }

    /// Stores the copy of a value, unless it is older than what is known.
    fn copy(&mut self, robot: &Name, value: Value, run: u32, now: Instant) {
        let key = (robot.clone(), value.topic.clone());
        let at = Position(run, value.number);
        if let Some(existing) = self.store.get(&key) {
            let known = existing.kept.filter(|Position(of, _)| *of == run);
            if known.is_some_and(|Position(_, number)| number >= value.number) {
                return;
            }
            if existing.origin == value.origin && existing.payload.is_none() == value.is_forgotten {
                let has_ended = value.has_ended;
                // Programs compare positions of one run.
                let is_change = existing.has_ended != has_ended || known.is_none();
                self.store.update(&key, is_change, |existing| {
                    (existing.kept, existing.has_ended) = (Some(at), has_ended);
                });
                return;
            }
        } else if value.is_forgotten {
            return;
        }
        if let Err(full) = self.store.put(key.clone(), Entry::of(value, Some(at), now)) {
            self.store.remove(&key);
            let text = match full {
                Full::Value(_) | Full::Robot => {
                    format!("{robot} has more retained values than a robot may have: some are not available here")
                }
                Full::Router => "there are more retained values than this router keeps: some are not available here".to_owned(),
            };
            self.warn(text);
            self.is_warned = true;
        }
    }

    fn on_page(&mut self, id: Id, payload: &Payload, now: Instant) {
        // A wrong answer counts as none, so that the question is asked again later.
        let Ok(page) = read::<Page>(&payload.bytes) else {
            return;
        };
        let robot = self.copies.asked(id).cloned();
        let Some(robot) = robot else {
            return;
        };
        if page.records.iter().any(|value| value.robot.is_some()) {
            return;
        }
        let interests = self.interests.clone();
        for value in &page.records {
            let key = zenoh_key(&self.place.fleet, &(robot.clone(), value.topic.clone()));
            if selects(&interests, &key) {
                self.copy(&robot, value.clone(), page.run, now);
            }
        }
        let fleet = &self.place.fleet;
        let Some(arrived) = self.copies.on_page(id, &page, &interests, fleet) else {
            return;
        };
        if let Some(keys) = arrived.forgotten {
            self.forget_others(&robot, &keys, page.run, now);
        }
        if arrived.is_complete {
            let number = self.store.bump();
            if let Some(copied) = self.copies.get_mut(&robot) {
                copied.complete_at = number;
            }
        }
    }

    /// Forgets the copies of those topics that are not of that run of a robot's router.
    fn forget_others(&mut self, robot: &Name, keys: &[OwnedKeyExpr], run: u32, now: Instant) {
        let fleet = &self.place.fleet;
        let is_other = |entry: &Entry| entry.kept.is_none_or(|Position(of, _)| of != run);
        let all = self.store.of(robot);
        let others = all.filter(|(key, entry)| is_other(entry) && is_selected(fleet, keys, key));
        let others: Vec<_> = others
            .map(|(key, entry)| (key.clone(), entry.clone()))
            .collect();
        for (key, entry) in others {
            if entry.payload.is_some() {
                self.forget(key, entry, now);
            }
        }
    }

    fn forget(&mut self, key: Key, entry: Entry, now: Instant) {
        let gone = Entry {
            payload: None,
            since: now,
            ..entry
        };
        // A topic without a value takes no room.
        let _ = self.store.put(key, gone);
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
            // Its topics count for a moment, since it may be restarted.
            if let Some(query) = self.polls.take(instance.0, now) {
                self.end(query);
            }
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
        let store = &self.store;
        for robot in self.copies.emptied(now, |robot| store.has_values_of(robot)) {
            let interests = self.interests.clone();
            self.forget_others(&robot, &interests, self.run, now);
        }
        self.answer_polls(now);
        self.ask(now);
    }

    /// Asks other routers what is due.
    fn ask(&mut self, now: Instant) {
        let interests = self.interests.clone();
        let KeySpace { fleet, robot: own } = self.place.clone();
        loop {
            let next = &mut self.next;
            let id = || {
                *next += 1;
                Id(*next)
            };
            let asked = (self.copies).next_question(now, (&fleet, &own), &interests, id);
            let Some((id, robot, question)) = asked else {
                break;
            };
            self.get(id, &robot, &question);
        }
        loop {
            let next = &mut self.next;
            let id = || {
                *next += 1;
                Id(*next)
            };
            let Some((id, robot)) = self.followers.due(now, id) else {
                break;
            };
            let keys = self.followers.keys(&robot);
            let select = |key: &Key| is_selected(&fleet, keys, key);
            let question = Question::Check {
                of: own.to_string(),
                at: Position(self.run, self.store.last()),
                digest: self.store.digest(&own, None, select),
                is_complete: self.grace.is_none(),
            };
            self.get(id, &robot, &question);
        }
    }

    fn get(&mut self, id: Id, robot: &Name, question: &Question) {
        let get = Get {
            payload: Some(write(question)),
            qos: Qos::REGISTRY,
            ..Get::new(self.place.own(Some(robot), STATE), TIMEOUT)
        };
        self.actions.push_back(Action::Get { id, get });
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

/// A value that is published.
struct Published {
    payload: Option<Payload>,
    qos: Qos,
    origin: Origin,
    sent_ms: u64,
    urgency: Urgency,
}

impl Published {
    fn of(entry: &Entry) -> Self {
        let size = entry
            .payload
            .as_ref()
            .map_or(0, |payload| payload.bytes.len());
        Self {
            payload: entry.payload.clone(),
            qos: match size > BULK {
                true => Urgency::Bulk.qos(),
                false => entry.urgency.qos(),
            },
            origin: entry.origin,
            sent_ms: entry.sent_ms,
            urgency: entry.urgency,
        }
    }
}

/// Returns the key expression of the topics of one robot that another one selects, of one or all robots.
fn of(fleet: &Name, robot: &Name, key: &OwnedKeyExpr) -> Option<OwnedKeyExpr> {
    let rest = key
        .as_str()
        .strip_prefix(fleet.as_str())?
        .strip_prefix('/')?;
    let (_, topics) = rest.split_once('/')?;
    OwnedKeyExpr::autocanonize(format!("{fleet}/{robot}/{topics}")).ok()
}

/// Returns whether a value that is kept is newer than one that a program gives back. Positions of two runs cannot be compared; then the
/// program's is taken, since a program that is alive has sent it.
fn is_newer(kept: Option<Position>, returned: Option<Position>) -> bool {
    match (kept, returned) {
        // It was published since this router has started.
        (None, _) => true,
        (Some(Position(run, number)), Some(Position(other, at))) => run == other && number >= at,
        (Some(_), None) => false,
    }
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
