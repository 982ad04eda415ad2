//! Owns a transfer that a program sends: its words, and the thread that offers and answers.
use std::{
    fmt,
    future::{Future, IntoFuture},
    path::{Path, PathBuf},
    pin::Pin,
    sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender, TrySendError},
    thread,
    time::{Duration, Instant},
};

use bytes::Bytes;
use tokio::sync::oneshot;
use zenoh::{bytes::ZBytes, query::Query, Session, Wait};

use super::queries::{ask, Whom};
use crate::{
    core::{
        encoding::Encoding,
        key::Place,
        name::Name,
        payload::Payload,
        topic::Topic,
        transfer::{
            self,
            offer::FileName,
            sender::{Outcome, Sender, Step},
            Answer, Offer, Progress, Request,
        },
    },
    error::Error,
    storage::Source,
};

/// How many requests and answers wait for the thread. What has no room is lost, and asked for again.
const WAITING: usize = 256;
/// How often progress is told at most.
pub(super) const PROGRESS_EVERY: Duration = Duration::from_millis(100);

/// What is transferred: a file by its path, or bytes.
#[derive(Clone, Debug)]
pub enum TransferSource {
    /// A file. It must not change before all is there.
    File(PathBuf),
    /// Bytes.
    Bytes(Bytes, Encoding),
}

/// A transfer to a robot. Does nothing until awaited.
#[must_use = "a transfer begins when it is awaited"]
pub struct Transfer {
    session: Session,
    place: Place,
    to: Name,
    topic: Topic,
    source: TransferSource,
    name: Option<String>,
    encoding: Option<Encoding>,
    patience: Option<Duration>,
    on_progress: Option<Box<dyn FnMut(Progress) + Send>>,
}

impl Transfer {
    pub(super) fn new(
        session: Session,
        place: Place,
        to: Name,
        topic: Topic,
        source: TransferSource,
    ) -> Self {
        Self {
            session,
            place,
            to,
            topic,
            source,
            name: None,
            encoding: None,
            patience: None,
            on_progress: None,
        }
    }

    /// What it is called there. Default: the file's name; bytes have none.
    pub fn named(mut self, name: impl Into<String>) -> Self {
        self.name = Some(name.into());
        self
    }

    /// What it is. Default: the payload's encoding; files and other bytes are bytes.
    pub fn encoding(mut self, encoding: Encoding) -> Self {
        self.encoding = Some(encoding);
        self
    }

    /// How long nothing may be heard of the receiver. Default: it may come back whenever it likes.
    pub fn patience(mut self, patience: Duration) -> Self {
        self.patience = Some(patience);
        self
    }

    /// Calls this with what the receiver holds, up to ten times a second, on the transfer's thread.
    pub fn on_progress(mut self, callback: impl FnMut(Progress) + Send + 'static) -> Self {
        self.on_progress = Some(Box::new(callback));
        self
    }

    /// Begins; what is returned waits for the end, and ends it when dropped.
    fn begin(self) -> impl Future<Output = Result<(), Error>> + Send {
        let (events, incoming) = mpsc::sync_channel(WAITING);
        let (done, outcome) = oneshot::channel();
        let stop = Stop(events.clone());
        let thread = thread::Builder::new().name("rect-transfer".into());
        let started = thread.spawn(move || {
            let how = self.run(&events, &incoming);
            // Nobody waits any more where it was dropped.
            let _ = done.send(how);
        });
        async move {
            let _stop = stop;
            if let Err(error) = started {
                let (what, reason) = ("no thread for the transfer", error.to_string());
                return Err(Error::Zenoh { what, reason });
            }
            outcome.await.unwrap_or(Err(Error::Closed))
        }
    }

    fn run(mut self, events: &SyncSender<Event>, incoming: &Receiver<Event>) -> Result<(), Error> {
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
        let offer = offer.encode();
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
                    self.offer(events, round.number, offer.clone(), timeout);
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
                Ok(Event::Query(query)) => serve(&mut sender, &source, &key, &query),
                Ok(Event::Answer(number, answer)) if number == round.number => {
                    round.answers.push(answer)
                }
                Ok(Event::Answered(number)) if number == round.number => {
                    sender.on_answers(now(), &round.answers);
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

/// Answers a request; what is no request gets no answer.
fn serve(sender: &mut Sender, source: &Source, key: &str, query: &Query) {
    let request = query
        .payload()
        .and_then(|bytes| Request::decode(&bytes.to_bytes()));
    let Some(request) = request else {
        return;
    };
    let sent = match sender.on_request(Instant::now(), &request) {
        Ok(None) => return,
        Ok(Some(range)) => match source.read(range) {
            Ok(bytes) => query.reply(key, bytes).wait(),
            Err(fault) => {
                let sent = query.reply_err(fault.encode()).wait();
                sender.on_fault(fault);
                sent
            }
        },
        Err(fault) => query.reply_err(fault.encode()).wait(),
    };
    if let Err(error) = sent {
        tracing::debug!("a piece was not sent: {error}");
    }
}

impl IntoFuture for Transfer {
    type Output = Result<(), Error>;
    type IntoFuture = Pin<Box<dyn Future<Output = Result<(), Error>> + Send>>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.begin())
    }
}

enum Event {
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

struct Stop(SyncSender<Event>);

impl Drop for Stop {
    fn drop(&mut self) {
        if let Err(TrySendError::Full(event)) = self.0.try_send(Event::Stop) {
            // The thread is behind; someone has to wait for it.
            let events = self.0.clone();
            let _ = thread::Builder::new().spawn(move || drop(events.send(event)));
        }
    }
}

/// What was told of the progress.
#[derive(Default)]
pub(super) struct Told(Option<(Instant, Progress)>);

impl Told {
    /// Tells it if it is another, and not too soon after the last time; the last one in any case.
    pub(super) fn tell(
        &mut self,
        progress: Progress,
        last: bool,
        mut callback: impl FnMut(Progress),
    ) {
        let now = Instant::now();
        let due = self
            .0
            .is_none_or(|(at, _)| last || now.duration_since(at) >= PROGRESS_EVERY);
        let is_new = self.0.is_none_or(|(_, told)| told != progress);
        if due && is_new {
            self.0 = Some((now, progress));
            callback(progress);
        }
    }
}

impl From<&Path> for TransferSource {
    fn from(path: &Path) -> Self {
        Self::File(path.to_owned())
    }
}

impl From<&PathBuf> for TransferSource {
    fn from(path: &PathBuf) -> Self {
        Self::File(path.clone())
    }
}

impl From<PathBuf> for TransferSource {
    fn from(path: PathBuf) -> Self {
        Self::File(path)
    }
}

impl From<Payload> for TransferSource {
    fn from(payload: Payload) -> Self {
        Self::Bytes(payload.bytes, payload.encoding)
    }
}

impl From<Bytes> for TransferSource {
    fn from(bytes: Bytes) -> Self {
        Self::Bytes(bytes, Encoding::BYTES)
    }
}

impl From<Vec<u8>> for TransferSource {
    fn from(bytes: Vec<u8>) -> Self {
        Bytes::from(bytes).into()
    }
}

impl fmt::Debug for Transfer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            to, topic, source, ..
        } = self;
        f.debug_struct("Transfer")
            .field("to", to)
            .field("topic", topic)
            .field("source", source)
            .finish_non_exhaustive()
    }
}
