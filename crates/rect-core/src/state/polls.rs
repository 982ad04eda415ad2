//! The programs of a robot that wait at its router for changes, and the topics that they subscribe to.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use zenoh_keyexpr::OwnedKeyExpr;

use super::{program::POLL, Position};
use crate::driver::QueryId;

/// How long the topics of a program count after its question has ended: it asks again at once, unless it has ended.
const ABSENT: Duration = Duration::from_secs(10);
/// The maximum number of programs.
const MAX_PROGRAMS: usize = 128;

/// A program that waits.
#[derive(Debug)]
pub(super) struct Poll {
    /// The question that is not answered yet.
    pub query: Option<QueryId>,
    pub since: Option<Position>,
    pub keys: Vec<OwnedKeyExpr>,
    /// When the question ends without changes, or, after it has ended, when the program is regarded as ended.
    until: Instant,
}

/// The programs that wait, by their runs.
#[derive(Debug, Default)]
pub(super) struct Polls(BTreeMap<u32, Poll>);

impl Polls {
    /// Handles the question of a program. Returns the question that it replaces, or this one if there are too many programs.
    pub(super) fn add(
        &mut self,
        program: u32,
        query: QueryId,
        since: Option<Position>,
        keys: Vec<OwnedKeyExpr>,
        now: Instant,
    ) -> Option<QueryId> {
        if self.0.len() >= MAX_PROGRAMS && !self.0.contains_key(&program) {
            return Some(query);
        }
        let poll = Poll {
            query: Some(query),
            since,
            keys,
            until: now + POLL,
        };
        self.0.insert(program, poll)?.query
    }

    /// Returns the programs whose question is open.
    pub(super) fn open(&self) -> impl Iterator<Item = (u32, &Poll)> {
        let all = self.0.iter().map(|(program, poll)| (*program, poll));
        all.filter(|(_, poll)| poll.query.is_some())
    }

    /// Handles that a program without a token gave a value: it asks a moment later, or has ended.
    pub(super) fn expect(&mut self, program: u32, now: Instant) {
        if self.0.len() < MAX_PROGRAMS {
            self.0.entry(program).or_insert(Poll {
                query: None,
                since: None,
                keys: Vec::new(),
                until: now + ABSENT,
            });
        }
    }

    /// Handles that nothing up to that position concerns a program.
    pub(super) fn on_nothing_new(&mut self, program: u32, at: Position) {
        if let Some(poll) = self.0.get_mut(&program) {
            poll.since = Some(at);
        }
    }

    /// Takes the question of a program, to answer it.
    pub(super) fn take(&mut self, program: u32, now: Instant) -> Option<QueryId> {
        let poll = self.0.get_mut(&program)?;
        poll.until = now + ABSENT;
        poll.query.take()
    }

    /// Returns the programs whose time is up: the questions to end, and the programs that have ended.
    pub(super) fn due(&mut self, now: Instant) -> (Vec<u32>, Vec<u32>) {
        let due = |(program, poll): (&u32, &Poll)| {
            (poll.until <= now).then_some((*program, poll.query.is_some()))
        };
        let due: Vec<_> = self.0.iter().filter_map(due).collect();
        let (open, gone): (Vec<_>, Vec<_>) = due.into_iter().partition(|(_, is_open)| *is_open);
        for (program, _) in &gone {
            self.0.remove(program);
        }
        let programs =
            |due: Vec<(u32, bool)>| due.into_iter().map(|(program, _)| program).collect();
        (programs(open), programs(gone))
    }

    /// Returns when [`due`](Self::due) has something next.
    pub(super) fn next(&self) -> Option<Instant> {
        self.0.values().map(|poll| poll.until).min()
    }

    /// Returns the topics that programs subscribe to, without those that others include.
    pub(super) fn interests(&self) -> Vec<OwnedKeyExpr> {
        let mut all: Vec<_> = self
            .0
            .values()
            .flat_map(|poll| &poll.keys)
            .cloned()
            .collect();
        all.sort_by(|a, b| a.as_str().cmp(b.as_str()));
        all.dedup();
        let is_included = |key: &OwnedKeyExpr| {
            let mut others = all.iter().filter(|other| *other != key);
            others.any(|other| other.includes(key))
        };
        all.iter()
            .filter(|key| !is_included(key))
            .cloned()
            .collect()
    }
}
