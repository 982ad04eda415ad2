//! Drives an outgoing transfer: offers it, answers the receiver's requests, and reports its progress.
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use super::{
    files::{PieceRead, ReadPiece, UsesFiles},
    progress_throttle::ProgressThrottle,
    sender::{Outcome, Response, Sender, Step as SenderStep},
    source, Answer, Fault, Offer, Progress, Refusal, Request, OFFERS,
};
use crate::{
    driver::{
        Action, Answer as QueryAnswer, Declaration, Driver, Event, Get, Id, QueryId, Reaction,
        Step, Target,
    },
    message::{encoding::Encoding, payload::Payload, urgency::Urgency},
    name::{key::KeySpace, Name},
};

/// The maximum number of programs of a robot whose answers to one offer are considered.
const MAX_ANSWERS: usize = 16;
/// The maximum number of queries that stay open until an offer is answered.
const MAX_HELD: usize = 16;
const PIECES: Id = Id(0);
/// The id of the first offer; the next ones follow.
const FIRST_OFFER: u64 = 1;

/// A transfer that is being sent.
#[derive(Debug)]
pub struct TransferPush {
    sender: Sender,
    recipient: Name,
    offer: Offer,
    /// The key at which the receiver gets offers.
    offers_key: String,
    /// The key of the pieces.
    key: String,
    actions: VecDeque<Action>,
    files: VecDeque<ReadPiece>,
    /// The number of the offer in flight, and the answers to it.
    round: (u64, Vec<Answer>),
    /// Queries that stay open until the offer with that number has been answered.
    held: BTreeMap<QueryId, u64>,
    throttle: ProgressThrottle,
    is_closed: bool,
}

/// Why a transfer was not completed.
#[derive(Clone, Debug, PartialEq)]
pub enum SendError {
    /// The receiver refused the offer.
    Refused(Refusal),
    /// The transfer began, but failed.
    Failed(Fault),
    /// The receiver did not answer, or its program takes no transfers.
    TimedOut {
        /// The expected event, for the text of the error.
        expected: String,
        /// For how long it was expected.
        timeout: Duration,
    },
    /// The session was closed, or the program has stopped the transfer.
    Closed,
}

impl TransferPush {
    /// Creates the transfer of `offer` to `recipient`, for a program of the robot of `place`. `timeout` is how long the
    /// receiver may be silent, or its program take none of the transfers that have arrived; `None` for no limit.
    pub fn new(
        place: &KeySpace,
        recipient: Name,
        offer: Offer,
        timeout: Option<Duration>,
        now: Instant,
    ) -> Self {
        let key = place.own(Some(&place.robot), &source(offer.id(&recipient)));
        let declaration = Declaration::Queryable {
            key: key.clone(),
            complete: true,
        };
        let id = PIECES;
        Self {
            sender: Sender::new(now, offer.size_bytes, timeout, offer.call),
            offers_key: place.own(Some(&recipient), OFFERS),
            recipient,
            offer,
            key,
            actions: [Action::Declare { id, declaration }].into(),
            files: VecDeque::new(),
            round: (0, Vec::new()),
            held: BTreeMap::new(),
            throttle: ProgressThrottle::default(),
            is_closed: false,
        }
    }

    /// Stops the transfer.
    pub fn stop(&mut self) {
        self.is_closed = true;
    }

    fn on_query(&mut self, now: Instant, query: QueryId, payload: &Payload) {
        let Some(request) = Request::decode(&payload.bytes) else {
            return self.answer(query, QueryAnswer::None);
        };
        match self.sender.on_request(now, &request) {
            Ok(Response::Piece(range)) => self.files.push_back(ReadPiece { query, range }),
            Ok(Response::Offer) => {
                let offer = self.offer.encode();
                self.reply(query, offer.into());
            }
            Ok(Response::AfterOffer(number)) if self.held.len() < MAX_HELD => {
                self.held.insert(query, number);
            }
            Ok(Response::AfterOffer(_)) => self.answer(query, QueryAnswer::None),
            Err(fault) => self.refuse(query, &fault),
        }
    }

    fn answer(&mut self, query: QueryId, answer: QueryAnswer) {
        self.actions.push_back(Action::Answer { query, answer });
    }

    fn reply(&mut self, query: QueryId, bytes: bytes::Bytes) {
        let key = self.key.clone();
        let payload = Payload::new(bytes, Encoding::BYTES);
        self.answer(query, QueryAnswer::Reply { key, payload });
    }

    fn refuse(&mut self, query: QueryId, fault: &Fault) {
        let error = Payload::new(fault.encode(), Encoding::BYTES);
        self.answer(query, QueryAnswer::Error(error));
    }

    fn on_offer_ended(&mut self, now: Instant, number: u64) {
        if number == self.round.0 {
            let answers = std::mem::take(&mut self.round.1);
            self.sender.on_answers(now, &answers);
        }
        let (ended, held): (BTreeMap<_, _>, _) = std::mem::take(&mut self.held)
            .into_iter()
            .partition(|(_, offer)| *offer <= number);
        self.held = held;
        for query in ended.into_keys() {
            self.answer(query, QueryAnswer::None);
        }
    }

    fn offer(&mut self, timeout: Duration) -> Action {
        self.round = (self.round.0 + 1, Vec::new());
        let get = Get {
            payload: Some(Payload::new(self.offer.encode(), Encoding::BYTES)),
            qos: Urgency::Bulk.qos(),
            target: Target::All,
            ..Get::new(self.offers_key.clone(), timeout)
        };
        let id = Id(FIRST_OFFER + self.round.0 - 1);
        Action::Get { id, get }
    }

    fn result(&self, outcome: Outcome) -> Result<(), SendError> {
        match outcome {
            Outcome::Done => Ok(()),
            Outcome::Refused(refusal) => Err(SendError::Refused(refusal)),
            Outcome::Failed(fault) => Err(SendError::Failed(fault)),
            Outcome::NoAnswer(timeout) => Err(SendError::TimedOut {
                expected: format!(
                    "reply of {} about the transfer {}",
                    self.recipient, self.offer.topic
                ),
                timeout,
            }),
            Outcome::NotTaken(timeout) => Err(SendError::TimedOut {
                expected: format!(
                    "room for the transfer {}: the program of {} has taken none of those that have arrived",
                    self.offer.topic, self.recipient
                ),
                timeout,
            }),
        }
    }
}

impl Driver for TransferPush {
    type Item = Progress;
    type Output = Result<(), SendError>;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Progress> {
        match event {
            Event::Query { query, payload, .. } => self.on_query(now, query, &payload),
            Event::Reply {
                id,
                reply: Ok(sample),
            } => {
                let is_current = id.0 == FIRST_OFFER + self.round.0 - 1;
                if is_current && self.round.1.len() < MAX_ANSWERS {
                    self.round.1.extend(Answer::decode(&sample.payload.bytes));
                }
                return Reaction::NONE;
            }
            Event::Ended { id } => self.on_offer_ended(now, id.0 + 1 - FIRST_OFFER),
            Event::Closed => self.stop(),
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Progress, Self::Output> {
        if let Some(action) = self.actions.pop_front() {
            return Step::Act(action);
        }
        if self.is_closed {
            return Step::Finished(Err(SendError::Closed));
        }
        if let Some(progress) = self.throttle.poll(now, self.sender.progress(), false) {
            return Step::Deliver(progress);
        }
        match self.sender.poll(now) {
            SenderStep::Offer(timeout) => Step::Act(self.offer(timeout)),
            SenderStep::Wait(until) => Step::Wait(Some(until)),
            SenderStep::Finished(outcome) => {
                match self.throttle.poll(now, self.sender.progress(), true) {
                    Some(progress) => Step::Deliver(progress),
                    None => Step::Finished(self.result(outcome)),
                }
            }
        }
    }
}

impl UsesFiles for TransferPush {
    type Action = ReadPiece;
    type Event = PieceRead;

    fn poll_file(&mut self) -> Option<ReadPiece> {
        self.files.pop_front()
    }

    fn on_file(&mut self, _now: Instant, PieceRead { query, result }: PieceRead) {
        match result {
            Ok(bytes) => self.reply(query, bytes),
            Err(fault) => {
                self.refuse(query, &fault);
                self.sender.on_fault(fault);
            }
        }
    }
}
