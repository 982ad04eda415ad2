//! Owns one transfer that comes: the thread that asks for its pieces and keeps them.
use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Receiver, Sender},
    },
    time::{Duration, Instant},
};

use zenoh::{bytes::ZBytes, Session};

use super::{
    options::{Incoming, Keep, ReceiveTransfers},
    queries::{ask, Whom},
    told::Told,
};
use crate::{
    core::{
        key::Place,
        transfer::{
            self,
            receiver::{Ask, Receiver as Pulling, Step},
            Fault, Offer, Progress, Request, TransferId,
        },
    },
    storage::{Content, Store},
};

/// How often what is there is written down.
const SAVE_EVERY: Duration = Duration::from_secs(2);
/// How long nobody looks whether the session was closed.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// How long a sender may take to learn how a transfer ended.
const TELL: Duration = Duration::from_secs(3);

/// What happens to it.
pub(super) enum Event {
    Reply(Ask, ZBytes),
    Fault(u64, Fault),
    End(u64),
    /// Its sender offers it again.
    Offered,
    Stop,
}

/// A transfer that comes.
pub(super) struct Pull {
    pub(super) session: Session,
    pub(super) place: Place,
    pub(super) options: ReceiveTransfers,
    pub(super) id: TransferId,
    pub(super) offer: Offer,
    pub(super) events: Sender<Event>,
}

impl Pull {
    /// Until its end. `on_held`: so much is there.
    pub(super) fn run(
        &self,
        incoming: &Receiver<Event>,
        on_held: impl Fn(u64),
    ) -> Result<Content, Fault> {
        let not_kept = |error: std::io::Error| Fault::NotKept(error.to_string());
        let opened = match &self.options.keep {
            Keep::Memory => {
                Store::in_memory(self.offer.size_bytes).map(|store| (store, Default::default()))
            }
            Keep::Folder(folder) => Store::in_folder(folder, self.id, &self.offer),
        };
        let (mut store, held) = opened.map_err(not_kept)?;
        let patience = self.options.patience;
        let mut pulling = Pulling::new(Instant::now(), self.offer.size_bytes, held, patience);
        let how = self.pull(&mut pulling, &mut store, incoming, on_held);
        match how {
            Ok(()) => store.finish().map_err(not_kept),
            Err(fault) => {
                if let Err(error) = store.interrupt(pulling.held(), &fault) {
                    tracing::warn!(
                        "what came of {:?} is not kept for later: {error}",
                        self.offer
                    );
                }
                Err(fault)
            }
        }
    }

    fn pull(
        &self,
        pulling: &mut Pulling,
        store: &mut Store,
        incoming: &Receiver<Event>,
        on_held: impl Fn(u64),
    ) -> Result<(), Fault> {
        let about = Incoming::from(&self.offer);
        let key = self.source();
        let mut told = Told::default();
        let mut tell = |progress: Progress, last| {
            on_held(progress.held_bytes);
            if let Some(callback) = &self.options.on_progress {
                told.tell(progress, last, |progress| callback(&about, progress));
            }
        };
        let (mut saved_at, mut saved_bytes) = (Instant::now(), pulling.progress().held_bytes);
        loop {
            let now = Instant::now();
            let held_bytes = pulling.progress().held_bytes;
            if held_bytes != saved_bytes && now.duration_since(saved_at) >= SAVE_EVERY {
                if let Err(error) = store.save(pulling.held()) {
                    pulling.on_not_kept(error.to_string());
                }
                (saved_at, saved_bytes) = (Instant::now(), held_bytes);
            }
            let until = match pulling.poll(now) {
                Step::Ask(ask) => {
                    self.ask(&key, ask);
                    continue;
                }
                Step::Check => {
                    match store.checksum() {
                        Ok(checksum) => pulling.on_checked(checksum == self.offer.checksum),
                        Err(error) => pulling.on_not_kept(error.to_string()),
                    }
                    continue;
                }
                Step::Over(how) => {
                    tell(pulling.progress(), true);
                    return how;
                }
                Step::Wait(until) => until,
            };
            let left = until.saturating_duration_since(now).min(LOOK_EVERY);
            match incoming.recv_timeout(left) {
                Ok(event) => on_event(pulling, store, event),
                Err(mpsc::RecvTimeoutError::Timeout) => {}
                Err(mpsc::RecvTimeoutError::Disconnected) => pulling.end(Fault::Stopped),
            }
            if self.session.is_closed() {
                pulling.end(Fault::Stopped);
            }
            tell(pulling.progress(), false);
        }
    }

    /// Where its sender answers.
    fn source(&self) -> String {
        let source = transfer::source(self.id);
        self.place.own(Some(&self.offer.from), &source)
    }

    fn ask(&self, key: &str, ask_for: Ask) {
        let (replies, end) = (self.events.clone(), self.events.clone());
        let ticket = ask_for.ticket;
        let payload = ask_for.request.encode();
        // What comes late is of use, too.
        let timeout = ask_for.timeout * 2;
        let answered = AtomicBool::new(false);
        let on_reply = move |reply: Result<ZBytes, ZBytes>| {
            // One question, one answer: more would fill the memory.
            if answered.swap(true, Ordering::Relaxed) {
                return;
            }
            let event = match reply {
                Ok(bytes) => Event::Reply(ask_for.clone(), bytes),
                // Other errors are Zenoh's own, such as that it took too long.
                Err(error) => match Fault::decode(&error.to_bytes()) {
                    Some(fault) => Event::Fault(ticket, fault),
                    None => return,
                },
            };
            let _ = replies.send(event);
        };
        let on_end = move || drop(end.send(Event::End(ticket)));
        ask(
            &self.session,
            key,
            Whom::One,
            payload,
            timeout,
            on_reply,
            on_end,
        );
    }

    /// Tells the sender that it is over, and waits until it has learned how, as long as it can be reached.
    pub(super) fn tell_end(&self) {
        let key = self.source();
        let (ended, end) = mpsc::channel::<()>();
        let on_end = move || drop(ended);
        let payload = Request::Ended.encode();
        ask(
            &self.session,
            &key,
            Whom::One,
            payload,
            TELL,
            |_| {},
            on_end,
        );
        let _ = end.recv_timeout(TELL);
    }
}

fn on_event(pulling: &mut Pulling, store: &mut Store, event: Event) {
    let now = Instant::now();
    match event {
        Event::Reply(ask, bytes) => {
            if !pulling.on_reply(now, &ask, bytes.len() as u64) {
                return;
            }
            let mut at = ask.range.start;
            for slice in bytes.slices() {
                if let Err(error) = store.write(at, slice) {
                    return pulling.on_not_kept(error.to_string());
                }
                at += slice.len() as u64;
            }
            pulling.on_kept(ask.range);
        }
        Event::Fault(ticket, fault) => pulling.on_fault(ticket, fault),
        Event::End(ticket) => pulling.on_silence(now, ticket),
        Event::Offered => pulling.on_offered(now),
        Event::Stop => pulling.end(Fault::Stopped),
    }
}

/// The two ends of what happens to a transfer.
pub(super) fn events() -> (Sender<Event>, Receiver<Event>) {
    // As many as requests are on their way, and no more: the window bounds them.
    mpsc::channel()
}
