//! Owns the choice of offers: which are taken, and what the others are answered.
//!
//! An offer names its sender in its payload, and any program may send one in any robot's name. So the inbox first asks the
//! named robot on that robot's own key, where access control lets nobody else answer: a transfer begins only after a program
//! of that robot has repeated the offer there ([`Request::Confirm`](super::Request::Confirm)). Until then the receiver
//! touches no file, reserves no memory, starts no thread and gives away no place.
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use zenoh_keyexpr::keyexpr;

use super::{
    answer::{Answer, Fault, Refusal},
    offer::{Offer, TransferId},
};
use crate::core::{name::Name, topic::Pattern};

/// How many that ended are remembered, so that an offer that is repeated is answered as before.
const ENDED: usize = 256;
/// How long a sender has to confirm its offer. After that the next offer begins anew.
const CONFIRM: Duration = Duration::from_secs(10);
/// Timeout of one question to the sender.
const ASK: Duration = Duration::from_secs(5);
/// Pause before the second question, because the sender's route may still be on its way; it doubles each time.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
/// The longest pause between two questions.
const LAST_PAUSE: Duration = Duration::from_secs(2);
/// The most unconfirmed offers in one robot's name.
const MAX_UNCONFIRMED_OF_ONE: usize = 8;
/// The most unconfirmed offers of all robots.
const MAX_UNCONFIRMED: usize = 64;

/// What a program takes. Nothing is taken without one.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Of whom, and about what.
    pub pattern: Pattern,
    /// The largest, in bytes.
    pub max_bytes: u64,
    /// How many at once, of which one sender gets at most half (rounded up); others wait until one has ended.
    pub max_running: usize,
}

/// The offers to one program's wish.
#[derive(Debug)]
pub struct Inbox {
    me: Name,
    wanted: Wanted,
    unconfirmed: BTreeMap<TransferId, Unconfirmed>,
    running: BTreeMap<TransferId, Running>,
    ended: VecDeque<(TransferId, u64, Answer)>,
}

/// An offer whose sender has not confirmed it. Only the name and the hash of its content are kept: the rest comes with the
/// confirmation.
#[derive(Debug)]
struct Unconfirmed {
    from: Name,
    since: Instant,
    pause: Duration,
    state: Asking,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Asking {
    /// The sender is asked then.
    Due(Instant),
    /// It has been asked. Without an answer or an end until then, the question counts as lost.
    Asked(Instant),
}

#[derive(Debug)]
struct Running {
    offer: Offer,
    held_bytes: u64,
}

/// What to do with an offer.
#[derive(Clone, Debug, PartialEq)]
pub enum Decision {
    /// It is running: tell its receiver that it was offered again, and answer this.
    Known(TransferId, Answer),
    /// Answer this. [`Inbox::poll`] then says whether to ask its sender.
    Answer(Answer),
}

/// The next action.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Ask this sender, and report what comes of it: [`Inbox::on_confirmed`], then [`Inbox::on_silence`].
    Ask(Question),
    /// Nothing before then, unless something comes; `None`: nothing at all.
    Wait(Option<Instant>),
}

/// A question to a sender: [`Request::Confirm`](super::Request::Confirm), to the key of [`super::source`] of that robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Question {
    /// Which transfer.
    pub id: TransferId,
    /// The robot that the offer names.
    pub from: Name,
    /// How long to wait for the reply.
    pub timeout: Duration,
}

/// The result of a confirmation.
#[derive(Clone, Debug, PartialEq)]
pub enum Confirmed {
    /// Begin to receive. Then [`Inbox::on_held`] and [`Inbox::on_ended`].
    Take(TransferId, Box<Offer>),
    /// Its sender was restarted: the transfer goes on, tell its receiver that it was offered again.
    Known(TransferId),
}

impl Inbox {
    /// Of this robot.
    pub fn new(me: Name, wanted: Wanted) -> Self {
        Self {
            me,
            wanted,
            unconfirmed: BTreeMap::new(),
            running: BTreeMap::new(),
            ended: VecDeque::new(),
        }
    }

    /// Handles an offer, whose claimed sender is not verified yet. Call [`Self::poll`] afterwards.
    pub fn on_offer(&mut self, now: Instant, bytes: &[u8]) -> Decision {
        let refused = |refusal| Decision::Answer(Answer::Refused(refusal));
        let offer = match Offer::decode(bytes) {
            Ok(offer) => offer,
            Err(error) => return refused(Refusal::NotUnderstood(error.to_string())),
        };
        let id = offer.id(&self.me);
        if let Some(running) = self.running.get(&id) {
            if !running.offer.is_same(&offer) {
                return refused(Refusal::NotUnderstood("another transfer has its id".into()));
            }
            let held_bytes = running.held_bytes;
            if running.offer.call != offer.call {
                // Its sender was restarted, or somebody else offers in its name: only the sender itself can tell.
                self.ask(now, id, &offer.from);
            }
            return Decision::Known(id, Answer::Running { held_bytes });
        }
        if let Some(answer) = self.answer_of(id, offer.call) {
            return Decision::Answer(answer.clone());
        }
        if let Some(refusal) = self.refusal(&offer) {
            return refused(refusal);
        }
        if !self.has_room(&offer.from) || !self.ask(now, id, &offer.from) {
            return Decision::Answer(Answer::Busy);
        }
        Decision::Answer(Answer::Running { held_bytes: 0 })
    }

    /// Returns what to do now. Call it until it says to wait.
    pub fn poll(&mut self, now: Instant) -> Step {
        let lost =
            |known: &Unconfirmed| matches!(known.state, Asking::Asked(until) if until <= now);
        let late = self.unconfirmed.iter().filter(|(_, known)| lost(known));
        let late: Vec<TransferId> = late.map(|(&id, _)| id).collect();
        late.into_iter().for_each(|id| self.on_no_answer(now, id));
        let due = |(_, known): &(&TransferId, &mut Unconfirmed)| matches!(known.state, Asking::Due(at) if at <= now);
        if let Some((&id, known)) = self.unconfirmed.iter_mut().find(due) {
            known.state = Asking::Asked(now + ASK + LAST_PAUSE);
            return Step::Ask(Question {
                id,
                from: known.from.clone(),
                timeout: ASK,
            });
        }
        let times = self.unconfirmed.values().map(|known| match known.state {
            Asking::Due(at) | Asking::Asked(at) => at,
        });
        Step::Wait(times.min())
    }

    /// Handles what the asked robot replied, which may be anything.
    pub fn on_confirmed(&mut self, question: &Question, reply: &[u8]) -> Option<Confirmed> {
        let offer = Offer::decode(reply).ok()?;
        let id = offer.id(&self.me);
        if id != question.id || offer.from != question.from {
            return None;
        }
        self.unconfirmed.remove(&id);
        if let Some(running) = self.running.get_mut(&id) {
            if !running.offer.is_same(&offer) {
                return None;
            }
            running.offer.call = offer.call;
            return Some(Confirmed::Known(id));
        }
        // The sender's own words count, not those of the offer that led to it.
        let is_new = self.answer_of(id, offer.call).is_none() && self.refusal(&offer).is_none();
        if !is_new || !self.has_room(&offer.from) {
            return None;
        }
        let running = Running {
            offer: offer.clone(),
            held_bytes: 0,
        };
        self.running.insert(id, running);
        Some(Confirmed::Take(id, Box::new(offer)))
    }

    /// The question has ended: nothing more comes of it.
    pub fn on_silence(&mut self, now: Instant, question: &Question) {
        self.on_no_answer(now, question.id);
    }

    fn on_no_answer(&mut self, now: Instant, id: TransferId) {
        let Some(known) = self.unconfirmed.get_mut(&id) else {
            return;
        };
        if !matches!(known.state, Asking::Asked(_)) {
            return;
        }
        if now.saturating_duration_since(known.since) + known.pause > CONFIRM {
            self.unconfirmed.remove(&id);
            return;
        }
        known.state = Asking::Due(now + known.pause);
        known.pause = (known.pause * 2).min(LAST_PAUSE);
    }

    /// Notes that this robot is to be asked. `false`: too many are being asked already.
    fn ask(&mut self, now: Instant, id: TransferId, from: &Name) -> bool {
        if self.unconfirmed.contains_key(&id) {
            return true;
        }
        let of_one = self
            .unconfirmed
            .values()
            .filter(|known| known.from == *from);
        let has_room = if of_one.count() >= MAX_UNCONFIRMED_OF_ONE {
            self.forget_one(|known| known.from == *from)
        } else {
            self.unconfirmed.len() < MAX_UNCONFIRMED || self.forget_one(|_| true)
        };
        if !has_room {
            return false;
        }
        let known = Unconfirmed {
            from: from.clone(),
            since: now,
            pause: FIRST_PAUSE,
            state: Asking::Due(now),
        };
        self.unconfirmed.insert(id, known);
        true
    }

    /// Makes room for a new offer: of those whose sender did not answer so far, the oldest goes.
    fn forget_one(&mut self, is_meant: impl Fn(&Unconfirmed) -> bool) -> bool {
        let is_silent = |known: &Unconfirmed| {
            matches!(known.state, Asking::Due(_)) && known.pause > FIRST_PAUSE && is_meant(known)
        };
        let silent = self
            .unconfirmed
            .iter()
            .filter(|(_, known)| is_silent(known));
        let oldest = silent.min_by_key(|(_, known)| known.since);
        match oldest.map(|(&id, _)| id) {
            Some(id) => self.unconfirmed.remove(&id).is_some(),
            None => false,
        }
    }

    fn answer_of(&self, id: TransferId, call: u64) -> Option<&Answer> {
        let mut ended = self.ended.iter();
        let found = ended.find(|(ended, ended_call, _)| *ended == id && *ended_call == call);
        found.map(|(_, _, answer)| answer)
    }

    fn refusal(&self, offer: &Offer) -> Option<Refusal> {
        let limit_bytes = self.wanted.max_bytes;
        if !self.wants(offer) {
            Some(Refusal::NotWanted)
        } else if offer.size_bytes > limit_bytes {
            Some(Refusal::TooLarge { limit_bytes })
        } else {
            None
        }
    }

    fn has_room(&self, from: &Name) -> bool {
        let all = self.running.len();
        let of_one = self
            .running
            .values()
            .filter(|known| known.offer.from == *from);
        all < self.wanted.max_running && of_one.count() < self.wanted.max_running.div_ceil(2)
    }

    fn wants(&self, offer: &Offer) -> bool {
        let pattern = &self.wanted.pattern;
        let of_whom = pattern.robot().is_none_or(|robot| *robot == offer.from);
        let both = (
            keyexpr::new(pattern.topic()),
            keyexpr::new(offer.topic.as_str()),
        );
        of_whom && matches!(both, (Ok(wanted), Ok(topic)) if wanted.intersects(topic))
    }

    /// So much of it is there.
    pub fn on_held(&mut self, id: TransferId, held_bytes: u64) {
        if let Some(running) = self.running.get_mut(&id) {
            running.held_bytes = held_bytes;
        }
    }

    /// It is over. What ended because nothing came any more, or by the program's wish, may be offered again.
    pub fn on_ended(&mut self, id: TransferId, how: &Result<(), Fault>) {
        let Some(running) = self.running.remove(&id) else {
            return;
        };
        let answer = match how {
            Ok(()) => Answer::Done,
            Err(Fault::Silence(_) | Fault::Stopped) => return,
            Err(fault) => Answer::Failed(fault.clone()),
        };
        if self.ended.len() == ENDED {
            self.ended.pop_front();
        }
        self.ended.push_back((id, running.offer.call, answer));
    }
}

#[cfg(test)]
mod tests;
