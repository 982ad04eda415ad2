//! Owns the offers that come to a program: the thread that answers them, and those that begin.
use std::{
    collections::HashMap,
    sync::{
        mpsc::{Receiver, Sender, SyncSender},
        Arc, Mutex, MutexGuard, PoisonError,
    },
    thread,
};

use tokio::sync::mpsc::Sender as Ended;
use zenoh::{query::Query, Session, Wait};

use super::{
    incoming::Received,
    options::{Incoming, ReceiveTransfers},
    pull::{self, Pull},
};
use crate::{
    core::{
        key::Place,
        transfer::{
            inbox::{Decision, Inbox},
            Answer, Fault, Offer, TransferId,
        },
    },
    error::Error,
};

/// What the threads of one taker share.
pub(super) struct Shared {
    session: Session,
    place: Place,
    options: ReceiveTransfers,
    state: Mutex<State>,
}

struct State {
    inbox: Inbox,
    running: HashMap<TransferId, Sender<pull::Event>>,
    is_stopped: bool,
    /// To the program; gone with the session.
    ended: Option<Ended<Result<Received, Error>>>,
}

impl Shared {
    pub(super) fn new(
        session: Session,
        place: Place,
        options: ReceiveTransfers,
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
            state: Mutex::new(state),
        })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Answers offers until there are no more.
    pub(super) fn answer_all(self: &Arc<Self>, offers: &Receiver<Query>, key: &str) {
        while let Ok(query) = offers.recv() {
            let bytes = query.payload().map(|bytes| bytes.to_bytes().into_owned());
            let answer = self.on_offer(&bytes.unwrap_or_default());
            if let Err(error) = query.reply(key, answer.encode()).wait() {
                tracing::debug!("an offer was not answered: {error}");
            }
        }
        self.stop();
        self.state().ended = None;
    }

    fn on_offer(self: &Arc<Self>, bytes: &[u8]) -> Answer {
        let mut state = self.state();
        match state.inbox.on_offer(bytes) {
            Decision::Answer(answer) => answer,
            Decision::Known(id, answer) => {
                if let Some(events) = state.running.get(&id) {
                    let _ = events.send(pull::Event::Offered);
                }
                answer
            }
            Decision::Take(id, _) if state.is_stopped => {
                state.inbox.on_ended(id, &Err(Fault::Stopped));
                Answer::Busy
            }
            Decision::Take(id, offer) => {
                let (events, incoming) = pull::events();
                state.running.insert(id, events.clone());
                drop(state);
                self.begin(id, *offer, events, incoming);
                Answer::Running { held_bytes: 0 }
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
        let delivered = match &result {
            Err(Fault::Stopped) => true,
            _ => {
                let ended = self.state().ended.clone();
                ended.is_some_and(|ended| ended.blocking_send(told).is_ok())
            }
        };
        let result = if delivered {
            result
        } else {
            Err(Fault::Stopped)
        };
        let mut state = self.state();
        state.running.remove(&pull.id);
        state.inbox.on_ended(pull.id, &result);
        drop(state);
        pull.tell_end();
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

/// Where offers wait for the thread. What has no room is offered again.
pub(super) fn offers() -> (SyncSender<Query>, Receiver<Query>) {
    std::sync::mpsc::sync_channel(64)
}
