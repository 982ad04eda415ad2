//! The values that a router has: those of its own robot, and copies of those of others. Each change gets the next number.
use std::{
    collections::BTreeMap,
    ops::Bound,
    time::{Duration, Instant},
};

use zenoh_keyexpr::OwnedKeyExpr;

use super::{
    page::{selects, Page, PAGE},
    Origin, Position, BULK, MAX_ROBOT, MAX_ROUTER, MAX_VALUE, OVERHEAD,
};
use crate::{
    message::{
        attachment::Sent,
        encoding::Encoding,
        payload::Payload,
        retained::{live::Live, value::Value},
        urgency::{Qos, Urgency},
    },
    name::{topic::Topic, Name},
};

/// The maximum number of forgotten topics that are remembered. A question for changes since an older one gets everything.
const MAX_FORGOTTEN: usize = 1024;

/// A robot and one of its topics.
pub(super) type Key = (Name, Topic);

/// A value, or the mark that there is none any more.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    /// The number of its last change here.
    pub number: u64,
    pub origin: Origin,
    /// `None`: forgotten.
    pub payload: Option<Payload>,
    pub urgency: Urgency,
    pub sent: Sent,
    /// When it was published, on this computer's clock.
    pub since: Instant,
    pub has_ended: bool,
    /// Its position at its keeper: of a copy at the router that it is a copy of, of an own value at an earlier run of this router.
    pub kept: Option<Position>,
    pub disk: bool,
    /// Whether it comes from the disk, and no program has given it since.
    pub is_loaded: bool,
}

/// Why a value is not kept.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Full {
    /// The value is too large.
    #[error("the value has {0} bytes, and at most {MAX_VALUE} are kept. It was published, and programs that start later do not get it")]
    Value(usize),
    /// The robot has too many values.
    #[error(
        "the retained topics of this robot have {MAX_ROBOT} bytes already. The value was published, and programs that start later do not get it: forget a topic"
    )]
    Robot,
    /// The router has too many values.
    #[error("this router has {MAX_ROUTER} bytes of retained values already, of all robots. The value was published, and programs that start later do not get it")]
    Router,
}

/// The values.
#[derive(Debug, Default)]
pub(super) struct Store {
    entries: BTreeMap<Key, Entry>,
    order: BTreeMap<u64, Key>,
    last: u64,
    /// Changes up to this number may be missing.
    floor: u64,
    forgotten: usize,
    sizes: BTreeMap<Name, usize>,
}

impl Store {
    pub(super) fn get(&self, key: &Key) -> Option<&Entry> {
        self.entries.get(key)
    }

    /// Returns the number of the last change.
    pub(super) fn last(&self) -> u64 {
        self.last
    }

    /// Counts a change that is not one of a value, and returns its number.
    pub(super) fn bump(&mut self) -> u64 {
        self.last += 1;
        self.last
    }

    /// Returns the entries of a robot.
    pub(super) fn of<'a>(&'a self, robot: &'a Name) -> impl Iterator<Item = (&'a Key, &'a Entry)> {
        self.entries.iter().filter(move |((of, _), _)| of == robot)
    }

    /// Stores a value, or that there is none any more, with the next number, which it returns.
    pub(super) fn put(&mut self, key: Key, mut entry: Entry) -> Result<u64, Full> {
        if let Some(payload) = &entry.payload {
            self.check(&key, payload)?;
        }
        self.remove(&key);
        entry.number = self.bump();
        match &entry.payload {
            Some(payload) => {
                *self.sizes.entry(key.0.clone()).or_default() += size(&key, payload);
            }
            None => self.forgotten += 1,
        }
        self.order.insert(entry.number, key.clone());
        self.entries.insert(key, entry);
        if self.forgotten > MAX_FORGOTTEN {
            self.drop_oldest_forgotten();
        }
        Ok(self.last)
    }

    /// Returns whether there is room for a value.
    fn check(&self, key: &Key, payload: &Payload) -> Result<(), Full> {
        if payload.bytes.len() > MAX_VALUE {
            return Err(Full::Value(payload.bytes.len()));
        }
        let previous = self
            .entries
            .get(key)
            .and_then(|entry| entry.payload.as_ref());
        let more = size(key, payload);
        let less = previous.map_or(0, |previous| size(key, previous));
        let of_robot = self.sizes.get(&key.0).copied().unwrap_or(0);
        if of_robot + more - less > MAX_ROBOT {
            return Err(Full::Robot);
        }
        match self.sizes.values().sum::<usize>() + more - less > MAX_ROUTER {
            true => Err(Full::Router),
            false => Ok(()),
        }
    }

    /// Changes what is known of an entry, with the next number if `is_change`.
    pub(super) fn update(&mut self, key: &Key, is_change: bool, change: impl FnOnce(&mut Entry)) {
        let next = self.last + 1;
        let Some(entry) = self.entries.get_mut(key) else {
            return;
        };
        change(entry);
        if is_change {
            self.order.remove(&entry.number);
            (entry.number, self.last) = (next, next);
            self.order.insert(next, key.clone());
        }
    }

    /// Removes an entry, as if it had never been.
    pub(super) fn remove(&mut self, key: &Key) {
        let Some(entry) = self.entries.remove(key) else {
            return;
        };
        self.order.remove(&entry.number);
        match &entry.payload {
            Some(payload) => {
                if let Some(of_robot) = self.sizes.get_mut(&key.0) {
                    *of_robot -= size(key, payload);
                    if *of_robot == 0 {
                        self.sizes.remove(&key.0);
                    }
                }
            }
            None => self.forgotten -= 1,
        }
    }

    fn drop_oldest_forgotten(&mut self) {
        let is_forgotten = |key: &Key| {
            let entry = self.entries.get(key);
            entry.is_some_and(|entry| entry.payload.is_none())
        };
        let oldest = self.order.iter().find(|(_, key)| is_forgotten(key));
        if let Some((&number, key)) = oldest {
            let key = key.clone();
            self.floor = number;
            self.remove(&key);
        }
    }

    /// Returns the changes after a number, as many as fit into a page. `select` returns whether those of a key belong to it.
    pub(super) fn page(
        &self,
        run: u32,
        since: Option<Position>,
        own: &Name,
        now: Instant,
        select: impl Fn(&Key) -> bool,
    ) -> Page {
        let since = since.filter(|Position(of, number)| {
            *of == run && *number >= self.floor && *number <= self.last
        });
        let after = since.map_or(0, |Position(_, number)| number);
        let mut page = Page {
            run,
            at: self.last,
            ..Page::default()
        };
        let mut bytes = 0;
        let changes = (Bound::Excluded(after), Bound::Unbounded);
        for (&number, key) in self.order.range(changes) {
            let Some(entry) = self.entries.get(key) else {
                continue;
            };
            if (since.is_none() && entry.payload.is_none()) || !select(key) {
                continue;
            }
            let payload = entry.payload.as_ref();
            let more = payload.map_or(OVERHEAD, |payload| size(key, payload));
            if bytes > 0 && bytes + more > PAGE {
                page.more = true;
                return page;
            }
            bytes += more;
            page.at = number;
            page.records.push(entry.value(key, own, now));
        }
        page.at = self.last;
        page
    }

    /// Returns a checksum of the topics of a robot and of the numbers that its values have at that run of its keeper; `None`: this one.
    pub(super) fn digest(
        &self,
        robot: &Name,
        run: Option<u32>,
        select: impl Fn(&Key) -> bool,
    ) -> u64 {
        let selected = self
            .of(robot)
            .filter(|(key, entry)| entry.payload.is_some() && select(key));
        let sums = selected.map(|(key, entry)| {
            let kept = entry.kept.filter(|Position(of, _)| Some(*of) == run);
            let number = match run {
                None => entry.number,
                Some(_) => kept.map_or(u64::MAX, |Position(_, number)| number),
            };
            hash(key.1.as_str().as_bytes(), number)
        });
        sums.fold(0, u64::wrapping_add)
    }
}

impl Entry {
    /// Returns the attachment of the value as a message, from the keeper with that run.
    pub(super) fn attachment(&self, run: u32) -> Vec<u8> {
        let live = Live {
            position: Position(run, self.number),
            origin: self.origin,
            sent: self.sent,
            urgency: self.urgency,
        };
        live.encode()
    }

    /// Returns the quality of service of the value as a message. A large one travels as bulk.
    pub(super) fn qos(&self) -> Qos {
        let payload = self.payload.as_ref();
        match payload.is_some_and(|payload| payload.bytes.len() > BULK) {
            true => Urgency::Bulk.qos(),
            false => self.urgency.qos(),
        }
    }

    /// Returns the entry as a value of a page of the router of `own`.
    pub(super) fn value(&self, (robot, topic): &Key, own: &Name, now: Instant) -> Value {
        let none = || Payload::new("", Encoding::BYTES);
        Value {
            robot: (robot != own).then(|| robot.clone()),
            topic: topic.clone(),
            number: self.number,
            origin: self.origin,
            payload: self.payload.clone().unwrap_or_else(none),
            urgency: self.urgency,
            sent: self.sent,
            age: now.saturating_duration_since(self.since),
            has_ended: self.has_ended,
            is_forgotten: self.payload.is_none(),
            kept: self.kept.filter(|_| robot != own),
        }
    }

    /// Returns the entry of a value that arrived in a page.
    pub(super) fn of(value: Value, kept: Option<Position>, now: Instant) -> Self {
        Self {
            number: 0,
            origin: value.origin,
            payload: (!value.is_forgotten).then_some(value.payload),
            urgency: value.urgency,
            sent: value.sent,
            since: before(now, value.age),
            has_ended: value.has_ended,
            kept,
            disk: false,
            is_loaded: false,
        }
    }
}

/// Returns a time before now; the beginning of the clock if it does not reach back that far.
pub(super) fn before(now: Instant, age: Duration) -> Instant {
    now.checked_sub(age).unwrap_or(now)
}

fn size((_, topic): &Key, payload: &Payload) -> usize {
    OVERHEAD + topic.as_str().len() + payload.encoding.as_str().len() + payload.bytes.len()
}

/// Returns the FNV-1a hash of bytes, beginning with a number. It only has to differ, not to resist anybody.
pub(super) fn hash(bytes: &[u8], number: u64) -> u64 {
    let all = number
        .to_le_bytes()
        .into_iter()
        .chain(bytes.iter().copied());
    all.fold(0xCBF2_9CE4_8422_2325, |hash: u64, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3)
    })
}

/// Returns the key of a topic, as Zenoh knows it.
pub(super) fn zenoh_key(fleet: &Name, (robot, topic): &Key) -> String {
    format!("{fleet}/{robot}/{topic}")
}

/// Returns whether the topic of a key is selected.
pub(super) fn is_selected(fleet: &Name, keys: &[OwnedKeyExpr], key: &Key) -> bool {
    selects(keys, &zenoh_key(fleet, key))
}
