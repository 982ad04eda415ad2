//! Owns the offers that come to a program: the thread that answers them, and those that begin.
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
    options::{Incoming, ReceiveTransfers},
    pull::{self, Pull},
    queries::{ask, Whom},
};
use crate::{
    core::{
        key::Place,
        transfer::{
            self,
            inbox::{Confirmed, Decision, Inbox, Question, Step},
            Answer, Fault, Offer, Request, TransferId,
        },
    },
    error::Error,
};

/// How many offers wait for the thread. What has no room is offered again.
const WAITING: usize = 64;

/// What the threads of one taker share.
pub(super) struct Shared {
    session: Session,
    place: Place,
    options: ReceiveTransfers,
    runtime: Handle,
    state: Mutex<State>,
}

struct State {
    inbox: Inbox,
    running: HashMap<TransferId, Sender<pull::Event>>,
    is_stopped: bool,
    /// To the program; gone with the session.
    ended: Option<Ended<Result<Received, Error>>>,
}

/// An event for the inbox.
pub(super) enum Event {
    Offer(Query),
    /// The robot that an offer names replied.
    Confirmed(Question, ZBytes),
    /// It replies no more.
    Silence(Question),
    /// No more offers come.
    Closed,
}

/// The end of Zenoh's side: offers go in, and no more than the thread can take.
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
        place: Place,
        options: ReceiveTransfers,
        runtime: Handle,
        inbox: Inbox,
        ended: Ended<Result<Received, Error>>,
    ) -> Arc<Self> {
        let state = State {
            inbox,
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

    /// Answers offers until there are no more.
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
                        tracing::debug!("an offer was not answered: {error}");
                    }
                }
                Ok(Event::Confirmed(question, reply)) => {
                    self.on_confirmed(&question, &reply.to_bytes());
                }
                Ok(Event::Silence(question)) => {
                    let inbox = &mut self.state().inbox;
                    inbox.on_silence(Instant::now(), &question);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Ok(Event::Closed) | Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        self.stop();
        self.state().ended = None;
    }

    /// Asks the robots that offers name whether they make them. Returns when there is something to do again.
    fn ask_senders(&self, incoming: &Inbound) -> Option<Instant> {
        loop {
            let step = self.state().inbox.poll(Instant::now());
            match step {
                Step::Ask(question) => self.ask(question, &incoming.sender),
                Step::Wait(until) => return until,
            }
        }
    }

    fn ask(&self, question: Question, events: &Sender<Event>) {
        let source = transfer::source(question.id);
        let key = self.place.own(Some(&question.from), &source);
        let (replies, end) = (events.clone(), events.clone());
        let (asked, timeout) = (question.clone(), question.timeout);
        let answered = AtomicBool::new(false);
        let on_reply = move |reply: Result<ZBytes, ZBytes>| {
            // One question, one answer: more would fill the memory.
            if let (Ok(reply), false) = (reply, answered.swap(true, Ordering::Relaxed)) {
                let _ = replies.send(Event::Confirmed(asked.clone(), reply));
            }
        };
        let on_end = move || drop(end.send(Event::Silence(question)));
        let payload = Request::Confirm.encode();
        ask(
            &self.session,
            &key,
            Whom::One,
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
        match state.inbox.on_offer(Instant::now(), bytes) {
            Decision::Answer(answer) => answer,
            Decision::Known(id, answer) => {
                state.tell(id, pull::Event::Offered);
                answer
            }
        }
    }

    fn on_confirmed(self: &Arc<Self>, question: &Question, reply: &[u8]) {
        let mut state = self.state();
        match state.inbox.on_confirmed(question, reply) {
            None => {}
            Some(Confirmed::Known(id)) => state.tell(id, pull::Event::Offered),
            Some(Confirmed::Take(id, _)) if state.is_stopped => {
                state.inbox.on_ended(id, &Err(Fault::Stopped));
            }
            Some(Confirmed::Take(id, offer)) => {
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
            let on_held = |held_bytes| this.state().inbox.on_held(id, held_bytes);
            let how = pull.run(&incoming, on_held);
            this.on_ended(&pull, how);
        });
        if let Err(error) = started {
            let mut state = self.state();
            state.running.remove(&id);
            state
                .inbox
                .on_ended(id, &Err(Fault::NotKept(error.to_string())));
        }
    }

    fn on_ended(&self, pull: &Pull, how: Result<crate::storage::Content, Fault>) {
        let offer = &pull.offer;
        let (result, told) = match how {
            Ok(content) => {
                let about = Incoming::from(offer);
                (Ok(()), Ok(Received::new(about, content)))
            }
            Err(fault) => {
                let (robot, topic) = (offer.from.clone(), offer.topic.clone());
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
        // Only what the program has, or will have, is done. It may be slow: then this waits, and a place stays taken.
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
        state.inbox.on_ended(pull.id, &result);
        drop(state);
        // First the sender: the program may exit as soon as it has been told.
        pull.tell_end();
        if let Some(room) = room {
            room.send(told);
        }
    }

    /// Nothing more is taken, and what runs ends.
    pub(super) fn stop(&self) {
        let mut state = self.state();
        state.is_stopped = true;
        for events in state.running.values() {
            let _ = events.send(pull::Event::Stop);
        }
    }
}

impl State {
    fn tell(&self, id: TransferId, event: pull::Event) {
        if let Some(events) = self.running.get(&id) {
            let _ = events.send(event);
        }
    }
}

/// The end of the thread.
pub(super) struct Inbound {
    events: Receiver<Event>,
    /// For what comes of its questions.
    sender: Sender<Event>,
    waiting: Arc<AtomicUsize>,
}

/// The two ends of what happens to an inbox. Offers are limited, and questions are by the inbox.
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
