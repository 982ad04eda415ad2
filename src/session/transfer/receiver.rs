//! Answers the offers of transfers that a program receives, on a separate thread, and starts those that are accepted.
use std::{
    collections::HashMap,
    sync::{
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc::{self, Receiver, RecvTimeoutError, Sender},
        Arc, Mutex, MutexGuard, PoisonError,
    },
    thread,
    time::Instant,
};

use tokio::{runtime::Handle, sync::mpsc::Sender as Ended};
use zenoh::{bytes::ZBytes, query::Query, Session, Wait};

use super::{
    incoming::Received,
    options::{IncomingTransfer, ReceiveOptions},
    pull::{self, Pull},
    queries::{ask, Target},
};
use crate::{
    core::{
        key::KeySpace,
        transfer::{
            self,
            admission::{Admission, Confirmed, Decision, Question, Step},
            Answer, Fault, Offer, Request, TransferId,
        },
    },
    error::Error,
};

/// Largest number of offers that wait for the thread. Further ones are dropped, and their senders repeat them.
const WAITING: usize = 64;

/// State shared by the threads of one [`Transfers`](super::Transfers).
pub(super) struct Shared {
    session: Session,
    place: KeySpace,
    options: ReceiveOptions,
    runtime: Handle,
    state: Mutex<State>,
}

struct State {
    admission: Admission,
    running: HashMap<TransferId, Sender<pull::Event>>,
    is_stopped: bool,
    /// Ended transfers, to be read by the program; `None` once the session is closed.
    ended: Option<Ended<Result<Received, Error>>>,
}

/// An event for the admission of transfers.
pub(super) enum Event {
    Offer(Query),
    /// The robot named by an offer has replied to the question whether it makes this offer.
    Confirmed(Question, ZBytes),
    /// The query has ended; no more replies follow.
    Silence(Question),
    /// The queryable was undeclared; no more offers follow.
    Closed,
}

/// The sending end of the thread's channel, used by Zenoh's callback. It limits the number of waiting offers.
pub(super) struct Offers {
    events: Sender<Event>,
    waiting: Arc<AtomicUsize>,
}

impl Offers {
    pub(super) fn push(&self, query: Query) {
        let has_room = |waiting| (waiting < WAITING).then_some(waiting + 1);
        let (order, waiting) = (Ordering::Relaxed, &self.waiting);
        if waiting.fetch_update(order, order, has_room).is_ok() {
            let _ = self.events.send(Event::Offer(query));
        }
    }
}

impl Drop for Offers {
    fn drop(&mut self) {
        let _ = self.events.send(Event::Closed);
    }
}

impl Shared {
    pub(super) fn new(
        session: Session,
        place: KeySpace,
        options: ReceiveOptions,
        runtime: Handle,
        admission: Admission,
        ended: Ended<Result<Received, Error>>,
    ) -> Arc<Self> {
        let state = State {
            admission,
            running: HashMap::new(),
            is_stopped: false,
            ended: Some(ended),
        };
        Arc::new(Self {
            session,
            place,
            options,
            runtime,
            state: Mutex::new(state),
        })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Answers offers until the queryable is undeclared.
    pub(super) fn answer_all(self: &Arc<Self>, incoming: &Inbound, key: &str) {
        loop {
            let event = match self.ask_senders(incoming) {
                Some(until) => incoming
                    .events
                    .recv_timeout(until.saturating_duration_since(Instant::now())),
                None => incoming.events.recv().map_err(RecvTimeoutError::from),
            };
            match event {
                Ok(Event::Offer(query)) => {
                    incoming.waiting.fetch_sub(1, Ordering::Relaxed);
                    let bytes = query.payload().map(|bytes| bytes.to_bytes().into_owned());
                    let answer = self.on_offer(&bytes.unwrap_or_default());
                    if let Err(error) = query.reply(key, answer.encode()).wait() {
                        tracing::debug!("cannot reply to the offer of a transfer: {error}");
                    }
                }
                Ok(Event::Confirmed(question, reply)) => {
                    self.on_confirmed(&question, &reply.to_bytes());
                }
                Ok(Event::Silence(question)) => {
                    let admission = &mut self.state().admission;
                    admission.on_no_reply(Instant::now(), &question);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Ok(Event::Closed) | Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        self.stop();
        self.state().ended = None;
    }

    /// Asks the robots named by offers to confirm them. Returns the time of the next call, if one is due.
    fn ask_senders(&self, incoming: &Inbound) -> Option<Instant> {
        loop {
            let step = self.state().admission.poll(Instant::now());
            match step {
                Step::Ask(question) => self.ask(question, &incoming.sender),
                Step::Wait(until) => return until,
            }
        }
    }

    fn ask(&self, question: Question, events: &Sender<Event>) {
        let source = transfer::source(question.id);
        let key = self.place.own(Some(&question.sender), &source);
        let (replies, end) = (events.clone(), events.clone());
        let (asked, timeout) = (question.clone(), question.timeout);
        let answered = AtomicBool::new(false);
        let on_reply = move |reply: Result<ZBytes, ZBytes>| {
            // Only the first reply counts: an unlimited number could exhaust the memory.
            if let (Ok(reply), false) = (reply, answered.swap(true, Ordering::Relaxed)) {
                let _ = replies.send(Event::Confirmed(asked.clone(), reply));
            }
        };
        let on_end = move || drop(end.send(Event::Silence(question)));
        let payload = Request::Confirm.encode();
        ask(
            &self.session,
            &key,
            Target::One,
            payload,
            timeout,
            on_reply,
            on_end,
        );
    }

    fn on_offer(&self, bytes: &[u8]) -> Answer {
        let mut state = self.state();
        if state.is_stopped {
            return Answer::Busy;
        }
        match state.admission.on_offer(Instant::now(), bytes) {
            Decision::Answer(answer) => answer,
            Decision::Running(id, answer) => {
                state.notify(id, pull::Event::Offered);
                answer
            }
        }
    }

    fn on_confirmed(self: &Arc<Self>, question: &Question, reply: &[u8]) {
        let mut state = self.state();
        match state.admission.on_confirmed(question, reply) {
            None => {}
            Some(Confirmed::Running(id)) => state.notify(id, pull::Event::Offered),
            Some(Confirmed::Accept(id, _)) if state.is_stopped => {
                state.admission.on_ended(id, &Err(Fault::Stopped));
            }
            Some(Confirmed::Accept(id, offer)) => {
                let (events, incoming) = pull::events();
                state.running.insert(id, events.clone());
                drop(state);
                self.begin(id, *offer, events, incoming);
            }
        }
    }

    fn begin(
        self: &Arc<Self>,
        id: TransferId,
        offer: Offer,
        events: Sender<pull::Event>,
        incoming: Receiver<pull::Event>,
    ) {
        let pull = Pull {
            session: self.session.clone(),
            place: self.place.clone(),
            options: self.options.clone(),
            id,
            offer,
            events,
        };
        let this = self.clone();
        let thread = thread::Builder::new().name("rect-transfer".into());
        let started = thread.spawn(move || {
            let on_received_bytes =
                |received_bytes| this.state().admission.on_received_bytes(id, received_bytes);
            let how = pull.run(&incoming, on_received_bytes);
            this.on_ended(&pull, how);
        });
        if let Err(error) = started {
            let mut state = self.state();
            state.running.remove(&id);
            state
                .admission
                .on_ended(id, &Err(Fault::NotStored(error.to_string())));
        }
    }

    fn on_ended(&self, pull: &Pull, how: Result<crate::storage::Content, Fault>) {
        let offer = &pull.offer;
        let (result, report) = match how {
            Ok(content) => {
                let about = IncomingTransfer::from(offer);
                (Ok(()), Ok(Received::new(about, content)))
            }
            Err(fault) => {
                let (robot, topic) = (offer.sender.clone(), offer.topic.clone());
                (
                    Err(fault.clone()),
                    Err(Error::TransferFailed {
                        robot,
                        topic,
                        fault,
                    }),
                )
            }
        };
        // A transfer is complete only if the program will receive it. Until a slow program reads the previous ones, this
        // thread waits, and the transfer counts as running.
        let room = match &result {
            Err(Fault::Stopped) => None,
            _ => {
                let ended = self.state().ended.clone();
                ended.and_then(|ended| self.runtime.block_on(ended.reserve_owned()).ok())
            }
        };
        let result = if room.is_some() {
            result
        } else {
            Err(Fault::Stopped)
        };
        let mut state = self.state();
        state.running.remove(&pull.id);
        state.admission.on_ended(pull.id, &result);
        drop(state);
        // The sender is notified first, because the program may exit as soon as it receives the transfer.
        pull.report_end();
        if let Some(room) = room {
            room.send(report);
        }
    }

    /// Stops the running transfers and accepts no further ones.
    pub(super) fn stop(&self) {
        let mut state = self.state();
        state.is_stopped = true;
        for events in state.running.values() {
            let _ = events.send(pull::Event::Stop);
        }
    }
}

impl State {
    fn notify(&self, id: TransferId, event: pull::Event) {
        if let Some(events) = self.running.get(&id) {
            let _ = events.send(event);
        }
    }
}

/// The receiving end of the thread's channel.
pub(super) struct Inbound {
    events: Receiver<Event>,
    /// Sends the replies to the thread's own queries.
    sender: Sender<Event>,
    waiting: Arc<AtomicUsize>,
}

/// Creates the thread's channel. The number of offers in it is limited here, the number of questions by the admission.
pub(super) fn events() -> (Offers, Inbound) {
    let (sender, events) = mpsc::channel();
    let waiting = Arc::<AtomicUsize>::default();
    let offers = Offers {
        events: sender.clone(),
        waiting: waiting.clone(),
    };
    let inbound = Inbound {
        events,
        sender,
        waiting,
    };
    (offers, inbound)
}
