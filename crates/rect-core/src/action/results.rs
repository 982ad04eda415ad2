//! Drives the part of a program that keeps its large results, and replies to the requests for their pieces, as the sender of a transfer
//! does. Nothing is offered to anybody: clients find the description of a result in the state of its goal.
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use bytes::Bytes;

use super::{result::LargeResult, KEPT_FOR};
use crate::{
    driver::{
        Action, Answer as QueryAnswer, Declaration, Driver, Event, Id, QueryId, Reaction, Step,
    },
    message::{encoding::Encoding, payload::Payload},
    name::key::KeySpace,
    transfer::{source, Fault, Request, TransferId},
};

/// The maximum size of the results of a program, in bytes. The bytes of the oldest ones go first.
const MAX_BYTES: usize = 64 << 20;
/// The maximum number of results of a program, which limits its declarations.
const MAX_RESULTS: usize = 64;
/// How long a result is kept at least after a request for one of its pieces.
const IN_USE: Duration = Duration::from_secs(60);

/// The large results of a program. Finishes when it is closed.
#[derive(Debug)]
pub struct Results {
    place: KeySpace,
    kept: BTreeMap<Id, Served>,
    actions: VecDeque<Action>,
    next: u64,
    is_closed: bool,
}

#[derive(Debug)]
struct Served {
    transfer: TransferId,
    key: String,
    /// `None` if newer results have taken its room.
    bytes: Option<Bytes>,
    until: Instant,
}

impl Results {
    /// Creates the results of a program of the robot of `place`: none so far.
    pub fn new(place: KeySpace) -> Self {
        Self {
            place,
            kept: BTreeMap::new(),
            actions: VecDeque::new(),
            next: 0,
            is_closed: false,
        }
    }

    /// Keeps a result for as long as the robot's router keeps the state of its goal.
    pub fn keep(&mut self, result: &LargeResult, bytes: Bytes, now: Instant) {
        let Some(transfer) = TransferId::parse(&result.id) else {
            return;
        };
        self.remove(|kept| kept.transfer == transfer);
        let key = self.place.own(Some(&self.place.robot), &source(transfer));
        let declaration = Declaration::Queryable {
            key: key.clone(),
            complete: true,
        };
        let id = Id(self.next);
        self.next += 1;
        self.actions.push_back(Action::Declare { id, declaration });
        let kept = Served {
            transfer,
            key,
            bytes: Some(bytes),
            until: now + KEPT_FOR,
        };
        self.kept.insert(id, kept);
        self.limit();
    }

    fn limit(&mut self) {
        let mut all: usize = self.kept.values().map(Served::size).sum();
        for kept in self.kept.values_mut() {
            if all > MAX_BYTES {
                all -= kept.size();
                kept.bytes = None;
            }
        }
        if self.kept.len() > MAX_RESULTS {
            if let Some((id, _)) = self.kept.pop_first() {
                self.actions.push_back(Action::Undeclare { id });
            }
        }
    }

    fn remove(&mut self, is_removed: impl Fn(&Served) -> bool) {
        let actions = &mut self.actions;
        self.kept.retain(|&id, kept| {
            let is_removed = is_removed(kept);
            if is_removed {
                actions.push_back(Action::Undeclare { id });
            }
            !is_removed
        });
    }

    fn on_query(&mut self, id: Id, query: QueryId, payload: &Payload, now: Instant) {
        let answer = match (self.kept.get_mut(&id), Request::decode(&payload.bytes)) {
            (Some(kept), Some(Request::Range { offset, length, .. })) => {
                kept.until = kept.until.max(now + IN_USE);
                match kept.piece(offset, length) {
                    Ok(bytes) => QueryAnswer::Reply {
                        key: kept.key.clone(),
                        payload: Payload::new(bytes, Encoding::BYTES),
                    },
                    Err(fault) => QueryAnswer::Error(Payload::new(fault.encode(), Encoding::BYTES)),
                }
            }
            _ => QueryAnswer::None,
        };
        self.actions.push_back(Action::Answer { query, answer });
    }
}

impl Served {
    fn size(&self) -> usize {
        self.bytes.as_ref().map_or(0, Bytes::len)
    }

    fn piece(&self, offset: u64, length: u32) -> Result<Bytes, Fault> {
        let gone = || Fault::Unreadable("newer results have taken its room".to_owned());
        let bytes = self.bytes.as_ref().ok_or_else(gone)?;
        let range = Request::range(offset, length, bytes.len() as u64)?;
        // A range of the result fits its length, and so a `usize`.
        Ok(bytes.slice(range.start as usize..range.end as usize))
    }
}

impl Driver for Results {
    type Item = std::convert::Infallible;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Query {
                id, query, payload, ..
            } => self.on_query(id, query, &payload, now),
            Event::Closed => self.is_closed = true,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        self.remove(|kept| kept.until <= now);
        match self.actions.pop_front() {
            Some(action) => Step::Act(action),
            None => Step::Wait(self.kept.values().map(|kept| kept.until).min()),
        }
    }
}
