//! Drives the reception of transfers by one program: answers offers, asks the senders to confirm them, and says which
//! transfers to begin.
use std::{
    collections::{BTreeMap, VecDeque},
    time::Instant,
};

use super::{
    admission::{Admission, AdmissionRules, Confirmed, Decision, Question, Step as AdmissionStep},
    source, Answer, Fault, Offer, Request, TransferId, OFFERS,
};
use crate::{
    driver::{
        Action, Answer as QueryAnswer, Declaration, Driver, Event, Get, Id, QueryId, Reaction, Step,
    },
    message::{encoding::Encoding, payload::Payload, urgency::Urgency},
    name::key::KeySpace,
};

/// The maximum number of offers that wait for an answer. Further ones are dropped, and their senders repeat them.
const MAX_WAITING: usize = 64;
const OFFERS_QUERYABLE: Id = Id(0);
/// The id of the first question; the next ones follow.
const FIRST_QUESTION: u64 = 1;

/// The reception of transfers. Finishes when it is stopped.
#[derive(Debug)]
pub struct TransferReception {
    place: KeySpace,
    offers_key: String,
    admission: Admission,
    actions: VecDeque<Action>,
    arrivals: VecDeque<Arrival>,
    questions: BTreeMap<Id, Question>,
    next_question: u64,
    is_stopped: bool,
}

/// A transfer that arrives.
#[derive(Clone, Debug, PartialEq)]
pub enum Arrival {
    /// Begin to receive the transfer. Report its progress with [`TransferReception::on_received_bytes`], and its end with
    /// [`TransferReception::on_ended`].
    Begin(TransferId, Box<Offer>),
    /// The sender has offered a running transfer again.
    OfferedAgain(TransferId),
}

impl TransferReception {
    /// Creates the reception of a program of the robot of `place`.
    pub fn new(place: KeySpace, rules: AdmissionRules) -> Self {
        let offers_key = place.own(Some(&place.robot), OFFERS);
        let declaration = Declaration::Queryable {
            key: offers_key.clone(),
            complete: false,
        };
        let id = OFFERS_QUERYABLE;
        Self {
            admission: Admission::new(place.robot.clone(), rules),
            place,
            offers_key,
            actions: [Action::Declare { id, declaration }].into(),
            arrivals: VecDeque::new(),
            questions: BTreeMap::new(),
            next_question: FIRST_QUESTION,
            is_stopped: false,
        }
    }

    /// Handles the progress of a transfer.
    pub fn on_received_bytes(&mut self, id: TransferId, received_bytes: u64) {
        self.admission.on_received_bytes(id, received_bytes);
    }

    /// Handles that a transfer has arrived, or failed, and waits until the program has room for the outcome. The timeout of its sender
    /// applies to this time.
    pub fn on_untaken(&mut self, id: TransferId) {
        self.admission.on_untaken(id);
    }

    /// Handles the end of a transfer. A transfer is complete only if the program will receive it: `has_room` is whether
    /// the program has room for the outcome.
    pub fn on_ended(&mut self, id: TransferId, result: Result<(), Fault>, has_room: bool) {
        let result = if has_room {
            result
        } else {
            Err(Fault::Stopped)
        };
        self.admission.on_ended(id, &result);
    }

    /// Accepts no further transfers. The executor stops those that are running.
    pub fn stop(&mut self) {
        self.is_stopped = true;
    }

    /// Returns whether no further transfers are accepted.
    pub fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    fn on_offer(&mut self, now: Instant, query: QueryId, offer: &Payload) {
        let answer = if self.actions.len() >= MAX_WAITING {
            QueryAnswer::None
        } else {
            let answer = self.answer_to(now, &offer.bytes);
            let key = self.offers_key.clone();
            let payload = Payload::new(answer.encode(), Encoding::BYTES);
            QueryAnswer::Reply { key, payload }
        };
        self.actions.push_back(Action::Answer { query, answer });
    }

    fn answer_to(&mut self, now: Instant, offer: &[u8]) -> Answer {
        if self.is_stopped {
            return Answer::Busy;
        }
        match self.admission.on_offer(now, offer) {
            Decision::Answer(answer) => answer,
            Decision::Running(id, answer) => {
                self.arrivals.push_back(Arrival::OfferedAgain(id));
                answer
            }
        }
    }

    fn on_confirmed(&mut self, question: &Question, reply: &[u8]) {
        match self.admission.on_confirmed(question, reply) {
            None => {}
            Some(Confirmed::Running(id)) => self.arrivals.push_back(Arrival::OfferedAgain(id)),
            Some(Confirmed::Accept(id, _)) if self.is_stopped => {
                self.admission.on_ended(id, &Err(Fault::Stopped));
            }
            Some(Confirmed::Accept(id, offer)) => {
                self.arrivals.push_back(Arrival::Begin(id, offer));
            }
        }
    }

    fn ask(&mut self, question: Question) -> Action {
        let id = Id(self.next_question);
        self.next_question += 1;
        let key = self.place.own(Some(&question.sender), &source(question.id));
        let get = Get {
            payload: Some(Payload::new(Request::Confirm.encode(), Encoding::BYTES)),
            qos: Urgency::Bulk.qos(),
            ..Get::new(key, question.timeout)
        };
        self.questions.insert(id, question);
        Action::Get { id, get }
    }
}

impl Driver for TransferReception {
    type Item = Arrival;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Arrival> {
        match event {
            Event::Query { query, payload, .. } => self.on_offer(now, query, &payload),
            Event::Reply {
                id,
                reply: Ok(sample),
            } => {
                // Only the first reply counts: an unlimited number could exhaust the memory.
                let Some(question) = self.questions.remove(&id) else {
                    return Reaction::NONE;
                };
                self.on_confirmed(&question, &sample.payload.bytes);
                self.admission.on_no_reply(now, &question);
            }
            Event::Ended { id } => {
                if let Some(question) = self.questions.remove(&id) {
                    self.admission.on_no_reply(now, &question);
                }
            }
            Event::Closed => self.stop(),
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Arrival, ()> {
        if let Some(action) = self.actions.pop_front() {
            return Step::Act(action);
        }
        if self.is_stopped {
            return Step::Finished(());
        }
        if let Some(arrival) = self.arrivals.pop_front() {
            return Step::Deliver(arrival);
        }
        match self.admission.poll(now) {
            AdmissionStep::Ask(question) => Step::Act(self.ask(question)),
            AdmissionStep::Wait(until) => Step::Wait(until),
        }
    }
}
