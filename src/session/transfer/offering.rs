//! Runs the thread of an outgoing transfer, which offers it and serves its pieces until it ends.
use std::{
    sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError},
    thread,
    time::{Duration, Instant},
};

use zenoh::{bytes::ZBytes, query::Query, Wait};

use super::{
    outgoing::{Transfer, TransferSource},
    progress_throttle::ProgressThrottle,
    queries::{ask, Target},
};
use crate::{
    core::{
        encoding::Encoding,
        transfer::{
            self,
            offer::FileName,
            sender::{Outcome, Response, Sender, Step},
            Answer, Offer, Request,
        },
    },
    error::Error,
    storage::Source,
};

/// Capacity of the thread's channel. Requests that find no room are lost, and the receiver repeats them.
pub(super) const WAITING: usize = 256;
/// Largest number of programs of a robot whose answers to one offer are considered.
const MAX_ANSWERS: usize = 16;
/// Largest number of queries that stay open until an offer is answered.
const MAX_HELD: usize = 16;

impl Transfer {
    /// Runs the transfer, from computing the checksum to its end.
    pub(super) fn run(
        mut self,
        events: &SyncSender<Event>,
        incoming: &Receiver<Event>,
    ) -> Result<(), Error> {
        let (source, offer) = self.prepare()?;
        let id = offer.id(&self.recipient);
        let key = self
            .place
            .own(Some(&self.place.robot), &transfer::source(id));
        let requests = events.clone();
        let _declared = self
            .session
            .declare_queryable(key.clone())
            .complete(true)
            .callback(move |query| drop(requests.try_send(Event::Query(query))))
            .wait()
            .map_err(Error::zenoh("cannot declare the queryable of the transfer"))?;
        let mut sender = Sender::new(Instant::now(), offer.size_bytes, self.timeout, offer.call);
        let mut throttle = ProgressThrottle::default();
        let mut round = Round::default();
        let mut served = Served {
            source,
            key,
            offer: offer.encode(),
            held: Vec::new(),
        };
        loop {
            throttle.report(sender.progress(), false, |progress| {
                if let Some(callback) = self.on_progress.as_mut() {
                    callback(progress);
                }
            });
            let until = match sender.poll(Instant::now()) {
                Step::Offer(timeout) => {
                    round = Round {
                        number: round.number + 1,
                        answers: Vec::new(),
                    };
                    self.offer(events, round.number, served.offer.clone(), timeout);
                    continue;
                }
                Step::Wait(until) => until,
                Step::Finished(outcome) => {
                    throttle.report(sender.progress(), true, |progress| {
                        if let Some(callback) = self.on_progress.as_mut() {
                            callback(progress);
                        }
                    });
                    return self.outcome(outcome);
                }
            };
            let left = until.saturating_duration_since(Instant::now());
            let now = Instant::now;
            match incoming.recv_timeout(left) {
                Ok(Event::Query(query)) => served.answer(&mut sender, query),
                Ok(Event::Answer(number, answer)) if round.takes(number) => {
                    round.answers.push(answer)
                }
                Ok(Event::Answered(number)) if number == round.number => {
                    sender.on_answers(now(), &round.answers);
                    served.held.retain(|(offer, _)| *offer > number);
                }
                Ok(Event::Answer(..) | Event::Answered(_)) | Err(RecvTimeoutError::Timeout) => {
                    if self.session.is_closed() {
                        return Err(Error::Closed);
                    }
                }
                Ok(Event::Stop) | Err(RecvTimeoutError::Disconnected) => return Err(Error::Closed),
            }
        }
    }

    fn prepare(&mut self) -> Result<(Source, Offer), Error> {
        let (source, name, encoding) = match &self.source {
            TransferSource::File(path) => {
                let source = Source::of_file(path).map_err(|reason| Error::File {
                    path: path.clone(),
                    reason,
                })?;
                let name = path
                    .file_name()
                    .map(|name| name.to_string_lossy().into_owned());
                (source, name, Encoding::BYTES)
            }
            TransferSource::Bytes(bytes, encoding) => {
                (Source::of_bytes(bytes.clone()), None, encoding.clone())
            }
        };
        let name = self.name.take().or(name).unwrap_or_default();
        let offer = Offer {
            sender: self.place.robot.clone(),
            topic: self.topic.clone(),
            name: FileName::new(&name)?,
            encoding: self.encoding.take().unwrap_or(encoding),
            size_bytes: source.size_bytes(),
            checksum: source.checksum(),
            call: rand::random(),
        };
        Ok((source, offer))
    }

    fn offer(&self, events: &SyncSender<Event>, number: u64, offer: Vec<u8>, timeout: Duration) {
        let key = self.place.own(Some(&self.recipient), transfer::OFFERS);
        let (answers, end) = (events.clone(), events.clone());
        let on_reply = move |reply: Result<ZBytes, ZBytes>| {
            let answer = reply
                .ok()
                .and_then(|bytes| Answer::decode(&bytes.to_bytes()));
            if let Some(answer) = answer {
                let _ = answers.try_send(Event::Answer(number, answer));
            }
        };
        // If the channel is full, the deadline of the offer ends it.
        let on_end = move || drop(end.try_send(Event::Answered(number)));
        ask(
            &self.session,
            &key,
            Target::All,
            offer,
            timeout,
            on_reply,
            on_end,
        );
    }

    fn outcome(self, outcome: Outcome) -> Result<(), Error> {
        let (robot, topic) = (self.recipient, self.topic);
        Err(match outcome {
            Outcome::Done => return Ok(()),
            Outcome::Refused(refusal) => Error::TransferRefused {
                robot,
                topic,
                refusal,
            },
            Outcome::Failed(fault) => Error::TransferFailed {
                robot,
                topic,
                fault,
            },
            Outcome::NoAnswer(timeout) => Error::TimedOut {
                expected: format!("reply of {robot} about the transfer {topic}"),
                timeout,
            },
        })
    }
}

/// The content of a transfer, from which it answers requests.
struct Served {
    source: Source,
    key: String,
    offer: Vec<u8>,
    /// Queries that stay open until the offer with that number has been answered.
    held: Vec<(u64, Query)>,
}

impl Served {
    /// Answers a request; ignores queries that are not valid requests.
    fn answer(&mut self, sender: &mut Sender, query: Query) {
        let request = query
            .payload()
            .and_then(|bytes| Request::decode(&bytes.to_bytes()));
        let Some(request) = request else {
            return;
        };
        let sent = match sender.on_request(Instant::now(), &request) {
            Ok(Response::Piece(range)) => match self.source.read(range) {
                Ok(bytes) => query.reply(&self.key, bytes).wait(),
                Err(fault) => {
                    let sent = query.reply_err(fault.encode()).wait();
                    sender.on_fault(fault);
                    sent
                }
            },
            Ok(Response::Offer) => query.reply(&self.key, &self.offer[..]).wait(),
            Ok(Response::AfterOffer(number)) => {
                if self.held.len() < MAX_HELD {
                    self.held.push((number, query));
                }
                return;
            }
            Err(fault) => query.reply_err(fault.encode()).wait(),
        };
        if let Err(error) = sent {
            tracing::debug!("cannot reply on {}: {error}", self.key);
        }
    }
}

/// An event for the thread of an outgoing transfer.
pub(super) enum Event {
    Query(Query),
    Answer(u64, Answer),
    /// All answers to the offer with that number have arrived.
    Answered(u64),
    Stop,
}

/// An offer and the answers to it.
#[derive(Default)]
struct Round {
    number: u64,
    answers: Vec<Answer>,
}

impl Round {
    /// Returns whether an answer belongs to this offer and is within the limit.
    fn takes(&self, number: u64) -> bool {
        number == self.number && self.answers.len() < MAX_ANSWERS
    }
}

/// Stops the transfer when dropped.
pub(super) struct Stop(SyncSender<Event>);

impl Stop {
    pub(super) fn new(events: &SyncSender<Event>) -> Self {
        Self(events.clone())
    }
}

impl Drop for Stop {
    fn drop(&mut self) {
        if let Err(TrySendError::Full(event)) = self.0.try_send(Event::Stop) {
            // The channel is full: another thread waits for room, since `drop` must not block.
            let events = self.0.clone();
            let _ = thread::Builder::new().spawn(move || drop(events.send(event)));
        }
    }
}
