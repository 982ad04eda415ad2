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
    /// Whether the program runs, as far as is known.
    is_running: bool,
    /// When the question ends without changes, or, after it has ended, when the program is regarded as ended.
    until: Instant,
}

/// The programs that wait, by their runs.
#[derive(Debug, Default)]
pub(super) struct Polls(BTreeMap<u32, Poll>);

impl Polls {
    /// Handles the question of a program. Returns the question that it replaces, or this one if there are too many programs, and whether
    /// the topics have changed.
    pub(super) fn add(
        &mut self,
        program: u32,
        query: QueryId,
        since: Option<Position>,
        keys: Vec<OwnedKeyExpr>,
        now: Instant,
    ) -> (Option<QueryId>, bool) {
        let known = self.0.get(&program);
        if self.0.len() >= MAX_PROGRAMS && known.is_none() {
            return (Some(query), false);
        }
        let has_changed = known.is_none_or(|poll| poll.keys != keys || !poll.is_running);
        let poll = Poll {
            query: Some(query),
            since,
            keys,
            is_running: true,
            until: now + POLL,
        };
        let replaced = self.0.insert(program, poll).and_then(|before| before.query);
        (replaced, has_changed)
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
                is_running: true,
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

    /// Handles that a program has ended. Its topics count for a moment, since it may be restarted. Returns its question.
    pub(super) fn on_ended(&mut self, program: u32, now: Instant) -> Option<QueryId> {
        self.0.get_mut(&program)?.is_running = false;
        self.take(program, now)
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

    /// Returns the topics that programs subscribe to, without those that others include. `is_running`: without those of programs
    /// that have ended.
    pub(super) fn interests(&self, is_running: bool) -> Vec<OwnedKeyExpr> {
        let programs = self.0.values();
        let programs = programs.filter(|poll| poll.is_running || !is_running);
        let mut all: Vec<_> = programs.flat_map(|poll| &poll.keys).cloned().collect();
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
