//! Carries out what the programs of the robot ask its router.
use std::time::{Duration, Instant};

use zenoh_keyexpr::OwnedKeyExpr;

use super::{Item, StateKeeper};
use crate::{
    driver::{Action, QueryId},
    message::{
        encoding::Encoding,
        payload::Payload,
        retained::live::Live,
        urgency::{Qos, Urgency},
    },
    name::topic::Topic,
    state::{
        page::{checked, read, write, Kept, Order, MAX_KEYS_OF_PROGRAM},
        store::{before, zenoh_key, Entry, Key},
        Origin, Position, BULK, OF_PROGRAMS,
    },
};

impl StateKeeper {
    pub(super) fn on_order(&mut self, query: QueryId, payload: &Payload, now: Instant) {
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
                    let (replaced, has_changed) = self.polls.add(program, query, since, keys, now);
                    replaced.into_iter().for_each(|query| self.end(query));
                    self.mark_program(program, false);
                    if has_changed {
                        self.on_interests();
                    }
                }
                Err(error) => self.refuse(query, error),
            },
            Order::Latest { key } => match checked(vec![key], 1) {
                Ok(keys) => {
                    // A copy to which no running program subscribes may be old.
                    let subscribed = self.of_others(true);
                    let is_current = |key: &OwnedKeyExpr| {
                        subscribed.iter().any(|subscribed| subscribed.includes(key))
                    };
                    let is_own = !keys.iter().all(is_current);
                    let page = self.page(None, &keys, now, is_own);
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
                    since: before(now, Duration::from_millis(age_ms)),
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
