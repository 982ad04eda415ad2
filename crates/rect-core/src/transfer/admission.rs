//! Decides which offers to accept, and answers the others.
//!
//! An offer contains the name of its sender, and any program may send an offer in the name of any robot. So the named
//! robot is first asked on that robot's own key, where access control lets no other robot reply: a transfer begins only
//! after a program of that robot has repeated the offer there ([`Request::Confirm`](super::Request::Confirm)). Until
//! then the receiver touches no file, reserves no memory, starts no thread, and the offer does not count towards the
//! limit of concurrent transfers.
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use zenoh_keyexpr::keyexpr;

use super::{
    answer::{Answer, Fault, Refusal},
    offer::{Offer, TransferId},
};
use crate::name::{topic::Pattern, Name};

/// How many finished transfers are remembered, so that a repeated offer is answered as before.
const ENDED: usize = 256;
/// How long a sender has to confirm its offer. After that, the next offer begins anew.
const CONFIRM: Duration = Duration::from_secs(10);
/// The timeout of one question to the sender.
const ASK: Duration = Duration::from_secs(5);
/// The pause before the second question, because the route to the sender may not be established yet. It doubles each
/// time.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
/// The maximum pause between two questions.
const LAST_PAUSE: Duration = Duration::from_secs(2);
/// How long a transfer without progress counts towards the limit of concurrent transfers. After that it may continue, but does not keep
/// out others: a robot that confirms its offers and then sends nothing would hold its places until the timeout, which is minutes.
const SILENT: Duration = Duration::from_secs(20);
/// The maximum number of concurrent transfers, including those without progress, as a multiple of the limit.
const MAX_WITH_SILENT: usize = 2;
/// The maximum number of unconfirmed offers in the name of one robot.
const MAX_UNCONFIRMED_OF_ONE: usize = 8;
/// The maximum number of unconfirmed offers of all robots.
const MAX_UNCONFIRMED: usize = 64;

/// The rules by which a program accepts transfers.
#[derive(Clone, Debug)]
pub struct AdmissionRules {
    /// Senders and topics that are accepted.
    pub pattern: Pattern,
    /// Maximum size of a transfer, in bytes.
    pub max_bytes: u64,
    /// Maximum number of concurrent transfers. One sender gets at most half of them (rounded up). Others wait until one
    /// has finished.
    pub max_concurrent: usize,
}

/// The admission of transfers for one call of a program.
#[derive(Debug)]
pub struct Admission {
    me: Name,
    rules: AdmissionRules,
    unconfirmed: BTreeMap<TransferId, Unconfirmed>,
    running: BTreeMap<TransferId, Running>,
    ended: VecDeque<(TransferId, u64, Answer)>,
    /// The time of the last offer or poll; `None` before the first one.
    now: Option<Instant>,
}

/// An offer whose sender has not confirmed it. Only its sender and the hash of its content are stored; the rest comes
/// with the confirmation.
#[derive(Debug)]
struct Unconfirmed {
    sender: Name,
    since: Instant,
    pause: Duration,
    state: Inquiry,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Inquiry {
    /// The sender is to be asked at this time.
    Due(Instant),
    /// The sender was asked. Without a reply by this time, the question counts as lost.
    Asked(Instant),
}

#[derive(Debug)]
struct Running {
    offer: Offer,
    received_bytes: u64,
    /// Whether something was received since `active_at`.
    has_progress: bool,
    /// The last time at which it was known to progress: its begin, or the first offer or question after progress.
    active_at: Instant,
    /// Whether the transfer has arrived and waits for the program.
    is_untaken: bool,
}

impl Running {
    /// Returns whether nothing was received for a while.
    fn is_silent(&self, now: Instant) -> bool {
        !self.is_untaken && now.saturating_duration_since(self.active_at) >= SILENT
    }
}

/// The reaction to an offer.
#[derive(Clone, Debug, PartialEq)]
pub enum Decision {
    /// The transfer is in progress: notify its receiver of the repeated offer, and reply with this answer.
    Running(TransferId, Answer),
    /// Reply with this answer. [`Admission::poll`] then returns whether to ask the sender.
    Answer(Answer),
}

/// The next action.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Ask this sender. Report the replies with [`Admission::on_confirmed`], and then their end with
    /// [`Admission::on_no_reply`].
    Ask(Question),
    /// Wait until this time, unless an event occurs. `None` to wait for the next event.
    Wait(Option<Instant>),
}

/// A question to a sender: [`Request::Confirm`](super::Request::Confirm), sent to that robot's key for the transfer
/// ([`super::source`]).
#[derive(Clone, Debug, PartialEq)]
pub struct Question {
    /// Id of the transfer.
    pub id: TransferId,
    /// Robot that the offer names.
    pub sender: Name,
    /// Timeout of the question.
    pub timeout: Duration,
}

/// The result of a confirmation.
#[derive(Clone, Debug, PartialEq)]
pub enum Confirmed {
    /// Begin to receive the transfer. Report its progress with [`Admission::on_received_bytes`], and its end with
    /// [`Admission::on_ended`].
    Accept(TransferId, Box<Offer>),
    /// The sender was restarted and the transfer continues: notify its receiver of the repeated offer.
    Running(TransferId),
}

impl Admission {
    /// Creates the admission for a program of the robot `me`.
    pub fn new(me: Name, rules: AdmissionRules) -> Self {
        Self {
            me,
            rules,
            unconfirmed: BTreeMap::new(),
            running: BTreeMap::new(),
            ended: VecDeque::new(),
            now: None,
        }
    }

    /// Takes over the time, and what has progressed until then.
    fn on_time(&mut self, now: Instant) {
        self.now = Some(now);
        for running in self.running.values_mut().filter(|one| one.has_progress) {
            (running.has_progress, running.active_at) = (false, now);
        }
    }

    /// Handles an offer whose sender is not verified yet. Call [`Self::poll`] afterwards.
    pub fn on_offer(&mut self, now: Instant, bytes: &[u8]) -> Decision {
        self.on_time(now);
        let refused = |refusal| Decision::Answer(Answer::Refused(refusal));
        let offer = match Offer::decode(bytes) {
            Ok(offer) => offer,
            Err(error) => return refused(Refusal::InvalidOffer(error.to_string())),
        };
        let id = offer.id(&self.me);
        if let Some(running) = self.running.get(&id) {
            if !running.offer.is_same(&offer) {
                return refused(Refusal::InvalidOffer(
                    "another transfer has the same id".into(),
                ));
            }
            let answer = match running.is_untaken {
                true => Answer::NotTaken,
                false => Answer::Running {
                    received_bytes: running.received_bytes,
                },
            };
            if running.offer.call != offer.call {
                // The sender was restarted, or another robot makes the offer in its name. Only the sender knows which.
                self.ask(now, id, &offer.sender);
            }
            return Decision::Running(id, answer);
        }
        if let Some(answer) = self.answer_of(id, offer.call) {
            return Decision::Answer(answer.clone());
        }
        if let Some(refusal) = self.refusal(&offer) {
            return refused(refusal);
        }
        if let Some(answer) = self.without_room(now, &offer.sender) {
            return Decision::Answer(answer);
        }
        if !self.ask(now, id, &offer.sender) {
            return Decision::Answer(Answer::Busy);
        }
        Decision::Answer(Answer::Running { received_bytes: 0 })
    }

    /// Returns what to do now. Call it repeatedly until it returns [`Step::Wait`].
    pub fn poll(&mut self, now: Instant) -> Step {
        self.on_time(now);
        let lost =
            |offer: &Unconfirmed| matches!(offer.state, Inquiry::Asked(until) if until <= now);
        let late = self.unconfirmed.iter().filter(|(_, known)| lost(known));
        let late: Vec<TransferId> = late.map(|(&id, _)| id).collect();
        late.into_iter()
            .for_each(|id| self.on_question_ended(now, id));
        let due = |(_, known): &(&TransferId, &mut Unconfirmed)| matches!(known.state, Inquiry::Due(at) if at <= now);
        if let Some((&id, known)) = self.unconfirmed.iter_mut().find(due) {
            known.state = Inquiry::Asked(now + ASK + LAST_PAUSE);
            return Step::Ask(Question {
                id,
                sender: known.sender.clone(),
                timeout: ASK,
            });
        }
        let times = self.unconfirmed.values().map(|known| match known.state {
            Inquiry::Due(at) | Inquiry::Asked(at) => at,
        });
        Step::Wait(times.min())
    }

    /// Handles an untrusted reply to a question. Returns `None` if it does not confirm the offer, or if the transfer is
    /// not accepted any more.
    pub fn on_confirmed(&mut self, question: &Question, reply: &[u8]) -> Option<Confirmed> {
        let offer = Offer::decode(reply).ok()?;
        let id = offer.id(&self.me);
        if id != question.id || offer.sender != question.sender {
            return None;
        }
        self.unconfirmed.remove(&id);
        if let Some(running) = self.running.get_mut(&id) {
            if !running.offer.is_same(&offer) {
                return None;
            }
            running.offer.call = offer.call;
            return Some(Confirmed::Running(id));
        }
        // The confirmation counts, and not the offer that led to it.
        let is_new = self.answer_of(id, offer.call).is_none() && self.refusal(&offer).is_none();
        // There was an offer before.
        let now = self.now?;
        if !is_new || self.without_room(now, &offer.sender).is_some() {
            return None;
        }
        let running = Running {
            offer: offer.clone(),
            received_bytes: 0,
            has_progress: false,
            active_at: now,
            is_untaken: false,
        };
        self.running.insert(id, running);
        Some(Confirmed::Accept(id, Box::new(offer)))
    }

    /// Handles the end of a question: there will be no further replies.
    pub fn on_no_reply(&mut self, now: Instant, question: &Question) {
        self.on_question_ended(now, question.id);
    }

    fn on_question_ended(&mut self, now: Instant, id: TransferId) {
        let Some(known) = self.unconfirmed.get_mut(&id) else {
            return;
        };
        if !matches!(known.state, Inquiry::Asked(_)) {
            return;
        }
        if now.saturating_duration_since(known.since) + known.pause > CONFIRM {
            self.unconfirmed.remove(&id);
            return;
        }
        known.state = Inquiry::Due(now + known.pause);
        known.pause = (known.pause * 2).min(LAST_PAUSE);
    }

    /// Schedules a question to the robot `from`. Returns `false` if too many questions are pending already.
    fn ask(&mut self, now: Instant, id: TransferId, from: &Name) -> bool {
        if self.unconfirmed.contains_key(&id) {
            return true;
        }
        let of_one = self
            .unconfirmed
            .values()
            .filter(|known| known.sender == *from);
        let has_room = if of_one.count() >= MAX_UNCONFIRMED_OF_ONE {
            self.forget_one(|known| known.sender == *from)
        } else {
            self.unconfirmed.len() < MAX_UNCONFIRMED || self.forget_one(|_| true)
        };
        if !has_room {
            return false;
        }
        let known = Unconfirmed {
            sender: from.clone(),
            since: now,
            pause: FIRST_PAUSE,
            state: Inquiry::Due(now),
        };
        self.unconfirmed.insert(id, known);
        true
    }

    /// Removes the oldest unconfirmed offer whose sender has not replied so far, to make room for a new one.
    fn forget_one(&mut self, is_eligible: impl Fn(&Unconfirmed) -> bool) -> bool {
        let is_silent = |offer: &Unconfirmed| {
            matches!(offer.state, Inquiry::Due(_))
                && offer.pause > FIRST_PAUSE
                && is_eligible(offer)
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
        let limit_bytes = self.rules.max_bytes;
        if !self.accepts(offer) {
            Some(Refusal::NotAccepted)
        } else if offer.size_bytes > limit_bytes {
            Some(Refusal::TooLarge { limit_bytes })
        } else {
            None
        }
    }

    /// Returns the answer to an offer of that robot for which there is no room, or `None` if there is room.
    fn without_room(&self, now: Instant, from: &Name) -> Option<Answer> {
        let max = self.rules.max_concurrent;
        if self.running.len() >= MAX_WITH_SILENT * max {
            return Some(Answer::Busy);
        }
        let active = self.running.values().filter(|known| !known.is_silent(now));
        let all: Vec<_> = active.collect();
        let of_one = all.iter().filter(|known| known.offer.sender == *from);
        let of_one: Vec<_> = of_one.copied().collect();
        let in_the_way = if of_one.len() >= max.div_ceil(2) {
            of_one
        } else if all.len() >= max {
            all
        } else {
            return None;
        };
        // One that still arrives makes room in time.
        Some(match in_the_way.iter().all(|known| known.is_untaken) {
            true => Answer::NotTaken,
            false => Answer::Busy,
        })
    }

    fn accepts(&self, offer: &Offer) -> bool {
        let pattern = &self.rules.pattern;
        let sender_matches = pattern.robot().is_none_or(|robot| *robot == offer.sender);
        let both = (
            keyexpr::new(pattern.topic()),
            keyexpr::new(offer.topic.as_str()),
        );
        sender_matches && matches!(both, (Ok(pattern), Ok(topic)) if pattern.intersects(topic))
    }

    /// Handles progress of a transfer.
    pub fn on_received_bytes(&mut self, id: TransferId, received_bytes: u64) {
        if let Some(running) = self.running.get_mut(&id) {
            running.has_progress |= running.received_bytes != received_bytes;
            running.received_bytes = received_bytes;
        }
    }

    /// Handles that a transfer has arrived, or failed, and waits for the program.
    pub fn on_untaken(&mut self, id: TransferId) {
        if let Some(running) = self.running.get_mut(&id) {
            running.is_untaken = true;
        }
    }

    /// Handles the end of a transfer. One that timed out or was stopped by the program may be offered again.
    pub fn on_ended(&mut self, id: TransferId, result: &Result<(), Fault>) {
        let Some(running) = self.running.remove(&id) else {
            return;
        };
        let answer = match result {
            Ok(()) => Answer::Done,
            Err(Fault::TimedOut(_) | Fault::Stopped) => return,
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
