//! Drives the log of a robot, for its router or for a program without one: keeps the last lines of each program, publishes new ones
//! for those who follow them, and answers questions.
use std::{
    collections::{BTreeMap, VecDeque},
    fmt,
    time::{Duration, Instant},
};

use super::{
    batch::Batch,
    level::Level,
    line::Line,
    page::{Kept, Page, Question, PAGE},
    read_key, GIVEN, MAX_BYTES, MAX_LINES, MAX_PROGRAMS, QOS, UNNAMED,
};
use crate::{
    driver::{Action, Answer, Declaration, Driver, Event, Id, QueryId, Reaction, Sample, Step},
    message::{encoding::Encoding, payload::Payload},
    name::{key::KeySpace, Name},
};

const LINES: Id = Id(0);
const QUESTIONS: Id = Id(1);
const PRIVATE_QUESTIONS: Id = Id(2);
/// The ids of the publishers follow this one.
const FIRST_PUBLISHER: u64 = 3;

/// The maximum number of runs of a program whose next number is known.
const MAX_RUNS: usize = 8;
/// How many bytes per second those who follow are sent at most, a quarter of what a Bluetooth link carries, and how many at once.
const PUBLISHED_PER_S: f64 = 8192.0;
const PUBLISHED_AT_ONCE: f64 = 16384.0;
/// The size at which a publication ends, in bytes of its lines. Those who follow ask for earlier ones.
const PUBLICATION: usize = 8 << 10;
/// The logger of the lines that the keeper adds.
const LOGGER: &str = "rect";

/// The log of a robot.
pub struct LogKeeper {
    place: KeySpace,
    run: u32,
    programs: BTreeMap<String, Ring>,
    /// The size of all lines, in bytes.
    size: usize,
    /// The number of the newest line.
    newest: u64,
    /// Whether somebody follows the lines of each publisher.
    is_followed: [bool; PUBLISHERS],
    /// Whether there are lines that those who follow were not sent.
    has_news: bool,
    /// Whether everything was sent at the last poll.
    is_idle: bool,
    budget: Budget,
    actions: VecDeque<Action>,
    is_closed: bool,
}

/// How many bytes those who follow may be sent. A publication is sent as a whole, so that the bytes may be negative.
struct Budget {
    bytes: f64,
    at: Option<Instant>,
}

/// The lines of one program.
#[derive(Default)]
struct Ring {
    lines: VecDeque<Entry>,
    size: usize,
    /// The number that the next line of each of its last runs has.
    runs: VecDeque<(u32, u64)>,
    /// The number of the newest line that each publisher has published.
    published: [u64; PUBLISHERS],
    /// The number of the newest line that was removed.
    removed: u64,
}

/// One for each least level of those who follow, without private lines and with them.
const PUBLISHERS: usize = 2 * Level::ALL.len();

/// A publisher. Nothing is published through it: it only shows whether somebody follows.
#[derive(Clone, Copy)]
struct Publisher {
    least: Level,
    shows_private: bool,
}

struct Entry {
    kept: Kept,
    is_private: bool,
}

impl fmt::Debug for LogKeeper {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "LogKeeper({}, {} lines)", self.place.robot, self.newest)
    }
}

impl LogKeeper {
    /// Creates the log of the robot of `place`. `run` is a random number.
    pub fn new(place: KeySpace, run: u32) -> Self {
        let own = Some(&place.robot);
        let given = place.own(own, &format!("{GIVEN}/*"));
        let read = |is_private| read_key(&place, own, is_private);
        let questions = |is_private| Declaration::Queryable {
            key: read(is_private),
            complete: true,
        };
        let declared = [
            (LINES, Declaration::Subscriber { key: given }),
            (QUESTIONS, questions(false)),
            (PRIVATE_QUESTIONS, questions(true)),
        ];
        let publishers = Publisher::all().map(|(index, publisher)| {
            let declaration = Declaration::Publisher {
                key: publisher.key(&place, "*"),
                qos: QOS,
                observes_matching: true,
            };
            (Id(FIRST_PUBLISHER + index as u64), declaration)
        });
        let declared = declared.into_iter().chain(publishers);
        let declared = declared.map(|(id, declaration)| Action::Declare { id, declaration });
        let actions = declared.collect();
        Self {
            run,
            programs: BTreeMap::new(),
            size: 0,
            newest: 0,
            is_followed: [false; PUBLISHERS],
            has_news: false,
            is_idle: true,
            budget: Budget {
                bytes: PUBLISHED_AT_ONCE,
                at: None,
            },
            actions,
            is_closed: false,
            place,
        }
    }

    /// Sends those who follow what is new without regard to the rate, because the session ends. Returns whether that is done.
    pub fn flush(&mut self) -> bool {
        self.budget.bytes = self.budget.bytes.max(1.0);
        self.is_idle
    }

    /// Returns all lines, in any order.
    #[cfg(test)]
    pub(super) fn everything(&self) -> Vec<&Kept> {
        let entries = self.programs.values().flat_map(|ring| &ring.lines);
        entries.map(|entry| &entry.kept).collect()
    }

    /// Keeps the lines of a batch.
    fn on_batch(&mut self, program: &str, batch: Batch) {
        let Some(last) = batch.lines.last() else {
            return;
        };
        let at = last.at;
        let ring = self.programs.entry(program.to_owned()).or_default();
        let lost = ring.on_run(batch.run, batch.first, batch.lines.len() as u64);
        if lost > 0 {
            let text = format!(
                "{lost} lines were lost: the program logs faster than the router can keep them"
            );
            let logger = LOGGER.to_owned();
            let line = Line {
                logger,
                ..Line::new(at, Level::Warn, text)
            };
            self.keep(program, line, batch.private);
        }
        for line in batch.lines {
            self.keep(program, line, batch.private);
        }
        self.shrink();
        (self.has_news, self.is_idle) = (true, false);
    }

    /// Keeps a line of a program that has a ring.
    fn keep(&mut self, program: &str, line: Line, is_private: bool) {
        let Some(ring) = self.programs.get_mut(program) else {
            return;
        };
        self.newest += 1;
        let kept = Kept {
            number: self.newest,
            program: program.to_owned(),
            line,
        };
        let size = kept.line.size();
        ring.lines.push_back(Entry { kept, is_private });
        ring.size += size;
        self.size += size;
        if ring.lines.len() > MAX_LINES {
            self.size -= ring.remove_oldest();
        }
    }

    /// Sends those who follow what is new, with one publication for each of them and each program.
    fn publish(&mut self) {
        self.has_news = false;
        for (index, publisher) in Publisher::all() {
            if !self.is_followed[index] {
                continue;
            }
            for (program, ring) in &mut self.programs {
                let Some((at, lines)) = ring.news(index, publisher) else {
                    continue;
                };
                let page = Page {
                    run: self.run,
                    at,
                    more: false,
                    lines,
                };
                let payload = page.write();
                self.budget.spend(payload.bytes.len());
                self.actions.push_back(Action::PutOnce {
                    key: publisher.key(&self.place, program),
                    payload,
                    qos: QOS,
                });
            }
        }
    }

    /// Removes the oldest lines of the program with the most bytes until all are within the limit.
    fn shrink(&mut self) {
        while self.size > MAX_BYTES {
            let largest = self.programs.values_mut().max_by_key(|ring| ring.size);
            let Some(ring) = largest else { return };
            self.size -= ring.remove_oldest();
        }
        while self.programs.len() > MAX_PROGRAMS {
            let newest = |ring: &Ring| ring.lines.back().map(|entry| entry.kept.number);
            let quietest = self.programs.iter().min_by_key(|(_, ring)| newest(ring));
            let Some(name) = quietest.map(|(name, _)| name.clone()) else {
                return;
            };
            if let Some(ring) = self.programs.remove(&name) {
                self.size -= ring.size;
            }
        }
    }

    /// Returns the newest lines that a question selects, as many as fit into a page.
    fn page(&self, question: &Question, shows_private: bool) -> Page {
        let entries = self.programs.values().flat_map(|ring| &ring.lines);
        let is_shown =
            |entry: &&Entry| (shows_private || !entry.is_private) && question.selects(&entry.kept);
        let mut selected: Vec<_> = entries.filter(is_shown).map(|entry| &entry.kept).collect();
        selected.sort_by_key(|kept| std::cmp::Reverse(kept.number));
        let mut size = 0;
        let fits = |kept: &&&Kept| {
            let before = size;
            size += kept.line.size();
            before < PAGE
        };
        let newest = selected.iter().take(question.count()).take_while(fits);
        let mut lines: Vec<_> = newest.map(|kept| (*kept).clone()).collect();
        lines.reverse();
        Page {
            run: self.run,
            at: self.newest,
            more: lines.len() < selected.len(),
            lines,
        }
    }

    /// Handles that the first one follows a publisher, or that nobody does any more. Lines that were kept before are asked for.
    fn on_followed(&mut self, publisher: usize, is_followed: bool) {
        self.is_followed[publisher] = is_followed;
        if is_followed {
            for ring in self.programs.values_mut() {
                ring.published[publisher] = self.newest;
            }
        }
    }

    fn on_question(&mut self, query: QueryId, payload: &Payload, shows_private: bool) {
        let answer = match Question::read(&payload.bytes) {
            Ok(question) => Answer::Reply {
                key: read_key(&self.place, Some(&self.place.robot), shows_private),
                payload: self.page(&question, shows_private).write(),
            },
            Err(reason) => Answer::Error(Payload::new(reason, Encoding::TEXT)),
        };
        self.actions.push_back(Action::Answer { query, answer });
    }

    fn on_sample(&mut self, sample: &Sample) {
        let (_, program) = sample.key.rsplit_once('/').unwrap_or_default();
        let is_program = program == UNNAMED || Name::new(program).is_ok();
        match Batch::read(&sample.payload.bytes) {
            Ok(batch) if is_program => self.on_batch(program, batch),
            _ => {}
        }
    }
}

impl Publisher {
    fn all() -> impl Iterator<Item = (usize, Self)> {
        let all = [false, true].into_iter().flat_map(|shows_private| {
            Level::ALL.map(|least| Self {
                least,
                shows_private,
            })
        });
        all.enumerate()
    }

    fn key(self, place: &KeySpace, program: &str) -> String {
        let key = read_key(place, Some(&place.robot), self.shows_private);
        format!("{key}/{}/{program}", self.least)
    }

    fn shows(self, entry: &Entry) -> bool {
        entry.kept.line.level >= self.least && (self.shows_private || !entry.is_private)
    }
}

impl Budget {
    /// Returns when something may be sent, if that is not now.
    fn wait(&mut self, now: Instant) -> Option<Instant> {
        let before = self.at.replace(now).unwrap_or(now);
        let earned = now.saturating_duration_since(before).as_secs_f64() * PUBLISHED_PER_S;
        self.bytes = PUBLISHED_AT_ONCE.min(self.bytes + earned);
        let missing = 1.0 - self.bytes;
        (missing > 0.0).then(|| now + Duration::from_secs_f64(missing / PUBLISHED_PER_S))
    }

    #[expect(
        clippy::cast_precision_loss,
        reason = "a publication has far fewer bytes than f64 counts exactly"
    )]
    fn spend(&mut self, bytes: usize) {
        self.bytes -= bytes as f64;
    }
}

impl Ring {
    /// Handles lines of a run, and returns how many are missing before them.
    fn on_run(&mut self, run: u32, first: u64, count: u64) -> u64 {
        let next = first.saturating_add(count);
        match self.runs.iter_mut().find(|(known, _)| *known == run) {
            Some((_, expected)) => {
                let lost = first.saturating_sub(*expected);
                *expected = next;
                lost
            }
            // Lines before it may have been given to an earlier run of the router.
            None => {
                self.runs.push_back((run, next));
                if self.runs.len() > MAX_RUNS {
                    self.runs.pop_front();
                }
                0
            }
        }
    }

    /// Returns the newest lines that a publisher has not published, as many as fit into a publication, and the number of the last one
    /// that it published. If lines in between are left out, that number is greater, so that those who follow notice.
    fn news(&mut self, index: usize, publisher: Publisher) -> Option<(u64, Vec<Kept>)> {
        let published = self.published[index];
        let new = self.lines.iter().rev();
        let new = new.take_while(|entry| entry.kept.number > published);
        let mut new = new.filter(|entry| publisher.shows(entry)).peekable();
        let (mut lines, mut size) = (Vec::new(), 0);
        while let Some(entry) = new.next_if(|_| size < PUBLICATION) {
            size += entry.kept.line.size();
            lines.push(entry.kept.clone());
        }
        let are_missing = new.peek().is_some() || self.removed > published;
        lines.reverse();
        let (first, last) = (lines.first()?.number, lines.last()?.number);
        self.published[index] = last;
        Some((if are_missing { first - 1 } else { published }, lines))
    }

    /// Removes the oldest line, and returns its size.
    fn remove_oldest(&mut self) -> usize {
        let oldest = self.lines.pop_front();
        if let Some(entry) = &oldest {
            self.removed = entry.kept.number;
        }
        let size = oldest.map_or(0, |entry| entry.kept.line.size());
        self.size -= size;
        size
    }
}

impl Driver for LogKeeper {
    type Item = std::convert::Infallible;
    type Output = ();

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Sample { id: LINES, sample } => self.on_sample(&sample),
            Event::Query {
                id, query, payload, ..
            } => self.on_question(query, &payload, id == PRIVATE_QUESTIONS),
            Event::Matching { id, matching } => {
                let index = id.0.checked_sub(FIRST_PUBLISHER);
                let index = index.and_then(|index| usize::try_from(index).ok());
                if let Some(index) = index.filter(|index| *index < PUBLISHERS) {
                    self.on_followed(index, matching);
                }
                return Reaction::NONE;
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
        if self.has_news && self.is_followed.contains(&true) && self.actions.is_empty() {
            if let Some(at) = self.budget.wait(now) {
                return Step::Wait(Some(at));
            }
            self.publish();
        }
        match self.actions.pop_front() {
            Some(action) => Step::Act(action),
            None => {
                self.is_idle = true;
                Step::Wait(None)
            }
        }
    }
}
