//! Exchanges values with the routers of other robots: asks for those that programs subscribe to, copies them, and answers.
use std::time::{Duration, Instant};

use zenoh_keyexpr::OwnedKeyExpr;

use super::{next_id, StateKeeper, PRESENCE, TIMEOUT, TOKENS};
use crate::{
    driver::{Action, Declaration, Get, Id, QueryId, Sample},
    message::{
        payload::Payload,
        retained::{live::Live, value::Value},
        urgency::Qos,
    },
    name::{key::KeySpace, Name},
    session::peers,
    state::{
        copies::is_of,
        page::{checked, read, write, Page, Question, MAX_KEYS},
        store::{is_selected, Entry, Full, Key},
        Position, STATE, TOKEN,
    },
};

impl StateKeeper {
    /// Handles that the programs may subscribe to other topics than before.
    pub(super) fn on_interests(&mut self) {
        let interests = self.of_others(false);
        if interests != self.interests {
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
        }
        self.subscribe();
    }

    /// Returns the topics of other robots that programs subscribe to. `is_running`: without those of programs that have ended.
    pub(super) fn of_others(&self, is_running: bool) -> Vec<OwnedKeyExpr> {
        let KeySpace { fleet, robot } = &self.place;
        let own = format!("{fleet}/{robot}/");
        // The values of this robot are not copies.
        let is_of_others = |key: &OwnedKeyExpr| !key.as_str().starts_with(&own);
        let interests = self.polls.interests(is_running).into_iter();
        let interests: Vec<_> = interests.filter(is_of_others).collect();
        match interests.len() > MAX_KEYS {
            true => {
                let all = OwnedKeyExpr::autocanonize(format!("{fleet}/*/**"));
                all.into_iter().collect()
            }
            false => interests,
        }
    }

    /// Subscribes to the topics that running programs subscribe to, of each robot that keeps values. A subscription to those of all robots
    /// would also match the publishers of this one, which then had a subscriber.
    pub(super) fn subscribe(&mut self) {
        let fleet = &self.place.fleet;
        let interests = self.of_others(true);
        let robots = self.copies.keeping();
        let keys = robots.flat_map(|robot| {
            let of_robot = interests.iter().filter(|key| is_of(fleet, robot, key));
            of_robot.filter_map(|key| Some((robot.clone(), of(fleet, robot, key)?)))
        });
        let keys: Vec<_> = keys.collect();
        let is_required =
            |(known, _): &(OwnedKeyExpr, Id)| keys.iter().any(|(_, key)| key == known);
        let (kept, removed): (Vec<_>, Vec<_>) = std::mem::take(&mut self.subscriptions)
            .into_iter()
            .partition(is_required);
        self.subscriptions = kept;
        let undeclare = |(_, id)| Action::Undeclare { id };
        self.actions.extend(removed.into_iter().map(undeclare));
        for (robot, key) in keys {
            if !self.subscriptions.iter().any(|(known, _)| *known == key) {
                let id = self.id();
                let text = key.to_string();
                self.declare(id, Declaration::Subscriber { key: text });
                self.subscriptions.push((key, id));
                // Values may have changed before.
                if let Some(copied) = self.copies.get_mut(&robot) {
                    copied.on_behind();
                }
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
    pub(super) fn on_question(&mut self, query: QueryId, payload: &Payload, now: Instant) {
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

    /// Handles a value that another robot has published.
    pub(super) fn on_live(&mut self, sample: Sample, now: Instant) {
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
            sent: live.sent,
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

    pub(super) fn on_page(&mut self, id: Id, payload: &Payload, now: Instant) {
        // A wrong answer counts as none, so that the question is asked again later.
        let Ok(mut page) = read::<Page>(&payload.bytes) else {
            return;
        };
        let robot = self.copies.asked(id).cloned();
        let Some(robot) = robot else {
            return;
        };
        if page.records.iter().any(|value| value.robot.is_some()) {
            return;
        }
        let KeySpace { fleet, .. } = &self.place;
        let is_selected = |value: &Value| {
            let key = (robot.clone(), value.topic.clone());
            is_selected(fleet, &self.interests, &key)
        };
        let records = std::mem::take(&mut page.records).into_iter();
        let selected: Vec<_> = records.filter(is_selected).collect();
        for value in selected {
            self.copy(&robot, value, page.run, now);
        }
        let (interests, fleet) = (&self.interests, &self.place.fleet);
        let Some(arrived) = self.copies.on_page(id, &page, interests, fleet) else {
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

    /// Handles that a robot has forgotten all of its values. The programs of this robot learn that as a whole.
    pub(super) fn on_emptied(&mut self, robot: &Name) {
        let copies: Vec<_> = self.store.of(robot).map(|(key, _)| key.clone()).collect();
        for key in copies {
            self.store.remove(&key);
        }
        let number = self.store.bump();
        if let Some(copied) = self.copies.get_mut(robot) {
            copied.complete_at = number;
        }
    }

    /// Forgets the copies of those topics that are not of that run of a robot's router.
    pub(super) fn forget_others(
        &mut self,
        robot: &Name,
        keys: &[OwnedKeyExpr],
        run: u32,
        now: Instant,
    ) {
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

    /// Asks other routers what is due.
    pub(super) fn ask(&mut self, now: Instant) {
        loop {
            let (fleet, own) = (&self.place.fleet, &self.place.robot);
            let id = || next_id(&mut self.last_id);
            let asked = (self.copies).next_question(now, (fleet, own), &self.interests, id);
            let Some((id, robot, question)) = asked else {
                break;
            };
            self.get(id, &robot, &question);
        }
        while let Some((id, robot)) = self.followers.due(now, || next_id(&mut self.last_id)) {
            let KeySpace { fleet, robot: own } = &self.place;
            let keys = self.followers.keys(&robot);
            let select = |key: &Key| is_selected(fleet, keys, key);
            let question = Question::Check {
                of: own.to_string(),
                at: Position(self.run, self.store.last()),
                digest: self.store.digest(own, None, select),
                is_complete: self.grace.is_none(),
            };
            self.get(id, &robot, &question);
        }
    }

    pub(super) fn get(&mut self, id: Id, robot: &Name, question: &Question) {
        let get = Get {
            payload: Some(write(question)),
            qos: Qos::REGISTRY,
            ..Get::new(self.place.own(Some(robot), STATE), TIMEOUT)
        };
        self.actions.push_back(Action::Get { id, get });
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
