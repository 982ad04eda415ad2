//! Carries out what the programs of the robot ask its router.
use std::time::{Duration, Instant};

use zenoh_keyexpr::OwnedKeyExpr;

use super::{Item, StateKeeper};
use crate::{
    driver::{Action, QueryId},
    message::{encoding::Encoding, payload::Payload, urgency::Urgency},
    name::topic::Topic,
    state::{
        page::{checked, read, write, Kept, NewValue, Order, MAX_KEYS_OF_PROGRAM},
        store::{before, zenoh_key, Entry, Key},
        Position, OF_PROGRAMS,
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
                    if has_changed {
                        self.mark_program(program, false);
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
            Order::Set(NewValue { ref topic, .. }) | Order::Forget { ref topic, .. } => {
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
            Order::Set(value) => {
                let encoding = Encoding::new(value.encoding);
                encoding.check_length().map_err(|error| error.to_string())?;
                let entry = Entry {
                    number: 0,
                    origin: value.origin,
                    payload: Some(Payload::new(value.bytes, encoding)),
                    urgency: value.urgency,
                    sent: value.sent,
                    since: before(now, Duration::from_millis(value.age_ms)),
                    has_ended: false,
                    kept: value.kept,
                    disk: value.disk,
                    is_loaded: false,
                };
                (entry, value.kept.is_some())
            }
            Order::Forget {
                origin,
                sent,
                age_ms,
                ..
            } => {
                let entry = Entry {
                    number: 0,
                    origin,
                    payload: None,
                    urgency: Urgency::Normal,
                    sent,
                    since: before(now, Duration::from_millis(age_ms)),
                    has_ended: false,
                    kept: None,
                    disk: false,
                    is_loaded: false,
                };
                (entry, false)
            }
            Order::Poll { .. } | Order::Latest { .. } => return Err("no value".to_owned()),
        };
        let kept = |number, is_replaced| Kept {
            at: Position(self.run, number),
            warning: None,
            is_replaced,
        };
        if let Some(existing) = existing {
            // It was repeated because the reply was lost, or the program comes back.
            if existing.origin == entry.origin {
                let kept = kept(existing.number, false);
                let has_ended = existing.has_ended;
                self.store.update(&key, has_ended, |existing| {
                    (existing.has_ended, existing.is_loaded) = (false, false);
                    // The program measures with a clock that nobody sets.
                    existing.since = entry.since;
                });
                return Ok(kept);
            }
            if is_newer(existing, &entry) {
                return Ok(kept(existing.number, true));
            }
        }
        let had_value = existing.is_some_and(|existing| existing.payload.is_some());
        if !self.programs.contains_key(&entry.origin.0) {
            self.polls.expect(entry.origin.0, now);
        }
        // A program may give back a value that this router does not know yet.
        if entry.payload.is_none() && !had_value && self.grace.is_none() {
            return Ok(kept(self.store.last(), false));
        }
        let was_on_disk = existing.is_some_and(|existing| existing.disk);
        let is_on_disk = entry.disk || was_on_disk;
        let has_value = entry.payload.is_some();
        let (payload, qos) = (entry.payload.clone(), entry.qos());
        let warning = self.not_on_disk.clone().filter(|_| entry.disk);
        match self.store.put(key.clone(), entry) {
            Ok(number) => {
                if is_on_disk && !self.is_without_disk {
                    // Before it is published: after a crash, nobody gets an older value than others had.
                    self.items.push_back(Item::Save(self.saved(now)));
                }
                if !is_restored && (had_value || has_value) {
                    self.publish(&key);
                }
                self.announce();
                self.on_change(&key, now);
                Ok(Kept {
                    at: Position(self.run, number),
                    warning,
                    is_replaced: false,
                })
            }
            Err(full) => {
                if let (false, Some(payload)) = (is_restored, payload) {
                    self.actions.push_back(Action::PutOnce {
                        key: zenoh_key(&self.place.fleet, &key),
                        payload,
                        qos,
                    });
                }
                Err(full.to_string())
            }
        }
    }

    /// Publishes a value that is kept, or that its topic is forgotten.
    fn publish(&mut self, key: &Key) {
        let Some(entry) = self.store.get(key) else {
            return;
        };
        self.actions.push_back(Action::PutRetained {
            key: zenoh_key(&self.place.fleet, key),
            payload: entry.payload.clone(),
            qos: entry.qos(),
            attachment: entry.attachment(self.run),
            number: entry.number as u32,
        });
    }
}

/// Returns whether a value that is kept is newer than one that a program gives, again or late. Positions of two runs cannot be compared.
/// But the router was restarted between them, so that their ages differ by more than a message takes.
fn is_newer(kept: &Entry, given: &Entry) -> bool {
    match (kept.kept, given.kept) {
        (Some(Position(run, number)), Some(Position(other, at))) if run == other => number >= at,
        // A call that waited for this router began after the disk was written.
        (_, None) if kept.is_loaded => false,
        _ => kept.since > given.since,
    }
}
