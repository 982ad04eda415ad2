//! Owns the thread of a transfer that is sent: it offers, and answers requests, until it is settled.
use std::{
    sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError},
    thread,
    time::{Duration, Instant},
};

use zenoh::{bytes::ZBytes, query::Query, Wait};

use super::{
    outgoing::{Transfer, TransferSource},
    queries::{ask, Whom},
    told::Told,
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

/// How many requests and answers wait for the thread. What has no room is lost, and asked for again.
pub(super) const WAITING: usize = 256;
/// How many programs of a robot are heard about one offer.
const MAX_ANSWERS: usize = 16;
/// How many receivers' programs are kept waiting for the end of the transfer.
const MAX_HELD: usize = 16;

impl Transfer {
    /// From the checksum to the end.
    pub(super) fn run(
        mut self,
        events: &SyncSender<Event>,
        incoming: &Receiver<Event>,
    ) -> Result<(), Error> {
        let (source, offer) = self.prepare()?;
        let id = offer.id(&self.to);
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
            .map_err(Error::zenoh("the transfer can't be served"))?;
        let mut sender = Sender::new(Instant::now(), offer.size_bytes, self.patience, offer.call);
        let mut told = Told::default();
        let mut round = Round::default();
        let mut served = Served {
            source,
            key,
            offer: offer.encode(),
            held: Vec::new(),
        };
        loop {
            told.tell(sender.progress(), false, |progress| {
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
                Step::Over(outcome) => {
                    told.tell(sender.progress(), true, |progress| {
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
            from: self.place.robot.clone(),
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
        let key = self.place.own(Some(&self.to), transfer::INBOX);
        let (answers, end) = (events.clone(), events.clone());
        let on_reply = move |reply: Result<ZBytes, ZBytes>| {
            let answer = reply
                .ok()
                .and_then(|bytes| Answer::decode(&bytes.to_bytes()));
            if let Some(answer) = answer {
                let _ = answers.try_send(Event::Answer(number, answer));
            }
        };
        // Without room for this one, the offer's own deadline ends it.
        let on_end = move || drop(end.try_send(Event::Answered(number)));
        ask(
            &self.session,
            &key,
            Whom::All,
            offer,
            timeout,
            on_reply,
            on_end,
        );
    }

    fn outcome(self, outcome: Outcome) -> Result<(), Error> {
        let (robot, topic) = (self.to, self.topic);
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
            Outcome::Unanswered(after) => Error::TimedOut {
                what: format!("word of {robot} about the transfer {topic}"),
                after,
            },
        })
    }
}

/// The content with which a transfer answers requests.
struct Served {
    source: Source,
    key: String,
    offer: Vec<u8>,
    /// Queries that stay open until the offer of that number has been answered.
    held: Vec<(u64, Query)>,
}

impl Served {
    /// Answers a request; what is no request gets no answer.
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
            tracing::debug!("a piece was not sent: {error}");
        }
    }
}

/// What happens to it.
pub(super) enum Event {
    Query(Query),
    Answer(u64, Answer),
    /// No more answers.
    Answered(u64),
    Stop,
}

/// An offer, and what was answered to it.
#[derive(Default)]
struct Round {
    number: u64,
    answers: Vec<Answer>,
}

impl Round {
    /// An answer to this offer, and not one too many.
    fn takes(&self, number: u64) -> bool {
        number == self.number && self.answers.len() < MAX_ANSWERS
    }
}

/// Ends it when dropped.
pub(super) struct Stop(SyncSender<Event>);

impl Stop {
    pub(super) fn new(events: &SyncSender<Event>) -> Self {
        Self(events.clone())
    }
}

impl Drop for Stop {
    fn drop(&mut self) {
        if let Err(TrySendError::Full(event)) = self.0.try_send(Event::Stop) {
            // The thread is behind; someone has to wait for it.
            let events = self.0.clone();
            let _ = thread::Builder::new().spawn(move || drop(events.send(event)));
        }
    }
}
