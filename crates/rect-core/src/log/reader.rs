//! Drives the reading of logs: asks the routers of robots for the last lines, newest first, and follows new ones.
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use super::{
    level::Level,
    page::{Kept, Page, Question},
    read_key, MAX_LAST,
};
use crate::{
    driver::{Action, Declaration, Driver, Event, Get, Id, Reaction, Sample, Step, Target},
    message::urgency::Urgency,
    name::{key::KeySpace, Name},
    session::peers::tokens,
};

/// The maximum number of robots whose lines one reader follows.
const MAX_ROBOTS: usize = 1024;
/// The maximum number of new lines of a robot that wait for earlier ones.
const MAX_HELD: usize = 2000;
/// The maximum number of lines that are asked for again after new lines were missed.
const MAX_MISSED: usize = 200;

const SUBSCRIBER: Id = Id(0);
const TOKENS: Id = Id(1);
/// The ids of questions follow this one.
const FIRST: u64 = 2;

/// Which lines are read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reading {
    /// The robot; `None`: all robots.
    pub robot: Option<Name>,
    /// The program; `None`: all programs.
    pub program: Option<Name>,
    /// The least important level.
    pub level: Level,
    /// The maximum number of lines of each robot that were logged before.
    pub last: usize,
    /// Whether new lines follow.
    pub follow: bool,
    /// Whether the private lines of the own robot are left out.
    pub without_private: bool,
    /// How long a router may take to answer a question.
    pub timeout: Duration,
}

/// An item that a reader delivers.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// Lines of a robot, in order.
    Lines {
        /// The robot.
        robot: Name,
        /// The lines; none if the robot has answered, and has none.
        lines: Vec<Kept>,
        /// Whether they are newer than all lines of that robot before. Otherwise they are older.
        is_new: bool,
    },
    /// All routers have answered that can be reached: the lines that follow are new.
    Complete,
    /// New lines of a robot were missed, because its program logged faster than the link carries.
    Missed(Name),
}

/// Reads logs. Finishes when all routers have answered, unless it follows.
#[derive(Debug)]
pub struct LogReader {
    place: KeySpace,
    reading: Reading,
    /// The private lines are read, too: those of the own robot.
    is_private: bool,
    sources: BTreeMap<Name, Source>,
    asked: BTreeMap<Id, Asked>,
    next: u64,
    actions: VecDeque<Action>,
    is_complete: bool,
    is_closed: bool,
}

/// The state of the log of one robot.
#[derive(Debug, Default)]
struct Source {
    run: u32,
    /// New lines have greater numbers.
    base: u64,
    /// The number of the last new line of each program.
    seen: BTreeMap<String, u64>,
    /// How many older lines are still expected.
    remaining: usize,
    /// New lines that wait until earlier ones have arrived.
    held: VecDeque<Kept>,
    /// Whether earlier ones were asked for.
    is_waiting: bool,
    /// Whether the robot cannot be reached.
    is_away: bool,
    has_missed: bool,
}

/// A question, and the robot that was asked.
#[derive(Clone, Debug)]
enum Asked {
    /// All routers (`None`), or that of a robot.
    First(Option<Name>),
    /// The lines before a number.
    Older(Name, u64),
    /// The lines that were missed.
    Missed(Name),
}

impl Default for Reading {
    /// Returns the last 100 lines of all robots.
    fn default() -> Self {
        Self {
            robot: None,
            program: None,
            level: Level::Debug,
            last: 100,
            follow: false,
            without_private: false,
            timeout: Duration::from_secs(10),
        }
    }
}

impl LogReader {
    /// Creates a reader of a program of the robot of `place`.
    pub fn new(place: KeySpace, reading: Reading) -> Self {
        let is_own = reading.robot.as_ref() == Some(&place.robot);
        let is_private = is_own && !reading.without_private;
        let mut reader = Self {
            is_private,
            sources: BTreeMap::new(),
            asked: BTreeMap::new(),
            next: FIRST,
            actions: VecDeque::new(),
            is_complete: false,
            is_closed: false,
            place,
            reading,
        };
        if reader.reading.follow {
            let key = reader.key(reader.reading.robot.as_ref());
            let program = reader.reading.program.as_ref().map_or("*", Name::as_str);
            let key = format!("{key}/{}/{program}", reader.reading.level);
            reader.actions.push_back(Action::Declare {
                id: SUBSCRIBER,
                declaration: Declaration::Subscriber { key },
            });
            let key = tokens(&reader.place, reader.reading.robot.as_ref());
            reader.actions.push_back(Action::Declare {
                id: TOKENS,
                declaration: Declaration::LivelinessSubscriber { key },
            });
        }
        let last = reader.reading.last.min(MAX_LAST);
        let first = Asked::First(reader.reading.robot.clone());
        reader.ask(first, last, None, None);
        reader
    }

    fn key(&self, robot: Option<&Name>) -> String {
        read_key(&self.place, robot, self.is_private)
    }

    fn ask(&mut self, asked: Asked, last: usize, after: Option<u64>, before: Option<u64>) {
        let id = Id(self.next);
        self.next += 1;
        let robot = match &asked {
            Asked::First(robot) => robot.as_ref(),
            Asked::Older(robot, _) | Asked::Missed(robot) => Some(robot),
        };
        let question = Question {
            last: Some(last),
            level: self.reading.level,
            program: self.reading.program.as_ref().map(Name::to_string),
            before,
            after,
        };
        let get = Get {
            payload: Some(question.write()),
            qos: Urgency::Bulk.qos(),
            target: Target::All,
            ..Get::new(self.key(robot), self.reading.timeout)
        };
        self.asked.insert(id, asked);
        self.actions.push_back(Action::Get { id, get });
    }

    fn on_page(&mut self, id: Id, robot: Name, page: Page) -> Vec<Item> {
        match self.asked.get(&id).cloned() {
            Some(Asked::First(_)) if !self.sources.contains_key(&robot) => {
                if self.sources.len() >= MAX_ROBOTS {
                    return Vec::new();
                }
                let source = Source {
                    run: page.run,
                    base: page.at,
                    remaining: self.reading.last,
                    ..Source::default()
                };
                self.sources.insert(robot.clone(), source);
                self.on_older(robot, page)
            }
            Some(Asked::Older(of, before)) if of == robot => {
                let run = self.sources.get(&robot).map(|source| source.run);
                let is_older = page.lines.iter().all(|kept| kept.number < before);
                // A router that has restarted has none of them.
                if run == Some(page.run) && is_older && !page.lines.is_empty() {
                    return self.on_older(robot, page);
                }
                Vec::new()
            }
            Some(Asked::Missed(of)) if of == robot => {
                let Some(source) = self.sources.get_mut(&robot) else {
                    return Vec::new();
                };
                source.has_missed |= page.more;
                if source.run == page.run {
                    // They are older than the ones that are held.
                    for kept in page.lines.into_iter().rev() {
                        source.held.push_front(kept);
                    }
                }
                Vec::new()
            }
            _ => Vec::new(),
        }
    }

    /// Handles a page of lines that were logged before, and asks for the next one.
    fn on_older(&mut self, robot: Name, page: Page) -> Vec<Item> {
        let Some(source) = self.sources.get_mut(&robot) else {
            return Vec::new();
        };
        let mut lines = page.lines;
        let surplus = lines.len().saturating_sub(source.remaining);
        lines.drain(..surplus);
        source.remaining -= lines.len();
        let remaining = source.remaining;
        if let (Some(first), true, 1..) = (lines.first(), page.more, remaining) {
            let before = first.number;
            self.ask(
                Asked::Older(robot.clone(), before),
                remaining,
                None,
                Some(before),
            );
        }
        let is_new = false;
        vec![Item::Lines {
            robot,
            lines,
            is_new,
        }]
    }

    /// Handles new lines of a program. If earlier ones are missing, it asks for them.
    fn on_new(&mut self, robot: &Name, page: Page) -> Vec<Item> {
        let is_first_answered = !self
            .asked
            .values()
            .any(|one| matches!(one, Asked::First(_)));
        let is_full = self.sources.len() >= MAX_ROBOTS;
        let is_known = self.sources.contains_key(robot);
        if !is_known && (!is_first_answered || is_full) {
            // The answer contains them, or shows that they are missing when the next ones arrive.
            return Vec::new();
        }
        let source = self.sources.entry(robot.clone()).or_default();
        if source.run != page.run {
            // All lines of a router that has restarted are new, and the last ones of a robot that was not reachable.
            *source = Source {
                run: page.run,
                ..Source::default()
            };
        }
        let Some((first, program)) = page.lines.first().map(|kept| (kept.number, &kept.program))
        else {
            return Vec::new();
        };
        let expected = source.expected(program);
        let is_missing = page.at > expected;
        for kept in page.lines {
            source.held.push_back(kept);
        }
        while source.held.len() > MAX_HELD {
            source.held.pop_front();
            source.has_missed = true;
        }
        if source.is_waiting {
            return Vec::new();
        }
        if is_missing {
            source.is_waiting = true;
            let asked = Asked::Missed(robot.clone());
            self.ask(asked, self.missed(), Some(expected), Some(first));
            return Vec::new();
        }
        source.release(robot)
    }

    /// Handles that a robot can be reached, or not any more. If it has returned, it is asked for its lines since.
    fn on_token(&mut self, robot: Name, is_gone: bool) {
        let is_complete = self.is_complete;
        match self.sources.get_mut(&robot) {
            Some(source) if is_gone => source.is_away = true,
            Some(source) if source.is_away && !source.is_waiting => {
                source.is_away = false;
                source.is_waiting = true;
                let newest = source.newest();
                let asked = Asked::Missed(robot);
                self.ask(asked, self.missed(), Some(newest), None);
            }
            Some(source) => source.is_away = false,
            // It was not reachable at the beginning.
            None if !is_gone && is_complete => {
                let last = self.reading.last.min(MAX_LAST);
                self.ask(Asked::First(Some(robot)), last, None, None);
            }
            None => {}
        }
    }

    /// Returns how many lines are asked for that were missed.
    fn missed(&self) -> usize {
        MAX_MISSED.max(self.reading.last.min(MAX_LAST))
    }

    fn on_ended(&mut self, id: Id) -> Vec<Item> {
        let Some(Asked::Missed(robot)) = self.asked.remove(&id) else {
            return Vec::new();
        };
        let source = self.sources.get_mut(&robot);
        source.map_or_else(Vec::new, |source| {
            source.is_waiting = false;
            source.release(&robot)
        })
    }

    fn on_sample(&mut self, sample: &Sample) -> Option<(Name, Page)> {
        let robot = self.place.robot_of(&sample.key)?;
        let is_asked = self.reading.robot.as_ref().is_none_or(|one| *one == robot);
        let mut page = Page::read(&sample.payload.bytes).ok()?;
        let level = self.reading.level;
        page.lines.retain(|kept| kept.line.level >= level);
        is_asked.then_some((robot, page))
    }
}

impl Source {
    /// Returns the number of the last line of a program that was delivered, or that is older than what is followed.
    fn expected(&self, program: &str) -> u64 {
        let seen = self.seen.get(program).copied();
        seen.unwrap_or_default().max(self.base)
    }

    /// Returns the number of the last line that was delivered. Lines of a link arrive in their order.
    fn newest(&self) -> u64 {
        let seen = self.seen.values().copied().max();
        seen.unwrap_or_default().max(self.base)
    }

    /// Delivers the new lines that are held, each one once.
    fn release(&mut self, robot: &Name) -> Vec<Item> {
        let mut lines = Vec::new();
        let mut held: Vec<_> = std::mem::take(&mut self.held).into();
        held.sort_by_key(|kept| kept.number);
        for kept in held {
            if kept.number > self.expected(&kept.program) {
                self.seen.insert(kept.program.clone(), kept.number);
                lines.push(kept);
            }
        }
        let mut items = Vec::new();
        if std::mem::take(&mut self.has_missed) {
            items.push(Item::Missed(robot.clone()));
        }
        if !lines.is_empty() {
            items.push(Item::Lines {
                robot: robot.clone(),
                lines,
                is_new: true,
            });
        }
        items
    }
}

impl Driver for LogReader {
    type Item = Item;
    type Output = ();

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Item> {
        let items = match event {
            Event::Sample { id: TOKENS, sample } => {
                if let Some(robot) = self.place.robot_of(&sample.key) {
                    self.on_token(robot, sample.is_deleted);
                }
                Vec::new()
            }
            Event::Sample { sample, .. } => match self.on_sample(&sample) {
                Some((robot, page)) => self.on_new(&robot, page),
                None => return Reaction::NONE,
            },
            Event::Reply {
                id,
                reply: Ok(sample),
            } => match self.on_sample(&sample) {
                Some((robot, page)) => self.on_page(id, robot, page),
                None => return Reaction::NONE,
            },
            Event::Ended { id } => self.on_ended(id),
            Event::Closed => {
                self.is_closed = true;
                Vec::new()
            }
            _ => return Reaction::NONE,
        };
        Reaction { items, polls: true }
    }

    fn poll(&mut self, _now: Instant) -> Step<Item, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        match self.actions.pop_front() {
            Some(action) => Step::Act(action),
            None if self.asked.is_empty() && !self.is_complete => {
                self.is_complete = true;
                Step::Deliver(Item::Complete)
            }
            None if self.is_complete && !self.reading.follow => Step::Finished(()),
            None => Step::Wait(None),
        }
    }
}
