//! Runs the thread of an incoming transfer, which requests its pieces and stores them.
use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Receiver, Sender},
    },
    time::{Duration, Instant},
};

use zenoh::{bytes::ZBytes, Session};

use super::{
    options::{Destination, IncomingTransfer, ReceiveOptions},
    progress_throttle::ProgressThrottle,
    queries::{ask, Target},
};
use crate::{
    core::{
        key::KeySpace,
        transfer::{
            self,
            receiver::{PieceRequest, Receiver as Pulling, Step},
            Fault, Offer, Progress, Request, TransferId,
        },
    },
    storage::{Content, Store},
};

/// Interval at which the received ranges are saved to a file.
const SAVE_EVERY: Duration = Duration::from_secs(2);
/// Interval at which the thread checks whether the session was closed.
const CHECK_EVERY: Duration = Duration::from_secs(1);

/// Timeout for notifying the sender that the transfer has ended.
const END_TIMEOUT: Duration = Duration::from_secs(3);

/// An event for the thread of an incoming transfer.
pub(super) enum Event {
    Reply(PieceRequest, ZBytes),
    Fault(u64, Fault),
    End(u64),
    /// The sender has offered the transfer again.
    Offered,
    Stop,
}

/// An incoming transfer.
pub(super) struct Pull {
    pub(super) session: Session,
    pub(super) place: KeySpace,
    pub(super) options: ReceiveOptions,
    pub(super) id: TransferId,
    pub(super) offer: Offer,
    pub(super) events: Sender<Event>,
}

impl Pull {
    /// Runs the transfer to its end. `on_received_bytes` is called with the number of received bytes.
    pub(super) fn run(
        &self,
        incoming: &Receiver<Event>,
        on_received_bytes: impl Fn(u64),
    ) -> Result<Content, Fault> {
        let not_kept = |error: std::io::Error| Fault::NotStored(error.to_string());
        let opened = match &self.options.destination {
            Destination::Memory => {
                Store::in_memory(self.offer.size_bytes).map(|store| (store, Default::default()))
            }
            Destination::Folder(folder) => Store::in_folder(folder, self.id, &self.offer),
        };
        let (mut store, held) = opened.map_err(not_kept)?;
        let timeout = self.options.timeout;
        let mut pulling = Pulling::new(Instant::now(), self.offer.size_bytes, held, timeout);
        let how = self.pull(&mut pulling, &mut store, incoming, on_received_bytes);
        match how {
            Ok(()) => store.finish().map_err(not_kept),
            Err(fault) => {
                if let Err(error) = store.interrupt(pulling.held(), &fault) {
                    tracing::warn!(
                        "cannot keep the received part of {:?} for later: {error}",
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
        on_received_bytes: impl Fn(u64),
    ) -> Result<(), Fault> {
        let about = IncomingTransfer::from(&self.offer);
        let key = self.source();
        let mut throttle = ProgressThrottle::default();
        let mut report = |progress: Progress, last| {
            on_received_bytes(progress.received_bytes);
            if let Some(callback) = &self.options.on_progress {
                throttle.report(progress, last, |progress| callback(&about, progress));
            }
        };
        let (mut saved_at, mut saved_bytes) = (Instant::now(), pulling.progress().received_bytes);
        loop {
            let now = Instant::now();
            let received_bytes = pulling.progress().received_bytes;
            if received_bytes != saved_bytes && now.duration_since(saved_at) >= SAVE_EVERY {
                if let Err(error) = store.save(pulling.held()) {
                    pulling.on_write_failed(error.to_string());
                }
                (saved_at, saved_bytes) = (Instant::now(), received_bytes);
            }
            let until = match pulling.poll(now) {
                Step::Request(ask) => {
                    self.ask(&key, ask);
                    continue;
                }
                Step::Check => {
                    match store.checksum() {
                        Ok(checksum) => pulling.on_checked(checksum == self.offer.checksum),
                        Err(error) => pulling.on_write_failed(error.to_string()),
                    }
                    continue;
                }
                Step::Finished(how) => {
                    report(pulling.progress(), true);
                    return how;
                }
                Step::Wait(until) => until,
            };
            let left = until.saturating_duration_since(now).min(CHECK_EVERY);
            match incoming.recv_timeout(left) {
                Ok(event) => on_event(pulling, store, event),
                Err(mpsc::RecvTimeoutError::Timeout) => {}
                Err(mpsc::RecvTimeoutError::Disconnected) => pulling.end(Fault::Stopped),
            }
            if self.session.is_closed() {
                pulling.end(Fault::Stopped);
            }
            report(pulling.progress(), false);
        }
    }

    /// Returns the key at which the sender serves the transfer.
    fn source(&self) -> String {
        let source = transfer::source(self.id);
        self.place.own(Some(&self.offer.sender), &source)
    }

    fn ask(&self, key: &str, ask_for: PieceRequest) {
        let (replies, end) = (self.events.clone(), self.events.clone());
        let ticket = ask_for.id;
        let payload = ask_for.request.encode();
        // A late reply is of use, too.
        let timeout = ask_for.timeout * 2;
        let answered = AtomicBool::new(false);
        let on_reply = move |reply: Result<ZBytes, ZBytes>| {
            // Only the first reply counts: an unlimited number could exhaust the memory.
            if answered.swap(true, Ordering::Relaxed) {
                return;
            }
            let event = match reply {
                Ok(bytes) => Event::Reply(ask_for.clone(), bytes),
                // Other errors are Zenoh's own, such as an expired timeout.
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
            Target::One,
            payload,
            timeout,
            on_reply,
            on_end,
        );
    }

    /// Notifies the sender that the transfer has ended, and waits until it has received the outcome or cannot be reached.
    pub(super) fn report_end(&self) {
        let key = self.source();
        let (ended, end) = mpsc::channel::<()>();
        let on_end = move || drop(ended);
        let payload = Request::Ended.encode();
        ask(
            &self.session,
            &key,
            Target::One,
            payload,
            END_TIMEOUT,
            |_| {},
            on_end,
        );
        let _ = end.recv_timeout(END_TIMEOUT);
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
                    return pulling.on_write_failed(error.to_string());
                }
                at += slice.len() as u64;
            }
            pulling.on_written(ask.range);
        }
        Event::Fault(ticket, fault) => pulling.on_fault(ticket, fault),
        Event::End(ticket) => pulling.on_no_reply(now, ticket),
        Event::Offered => pulling.on_offered(now),
        Event::Stop => pulling.end(Fault::Stopped),
    }
}

/// Creates the channel of the thread.
pub(super) fn events() -> (Sender<Event>, Receiver<Event>) {
    // The window limits the number of requests in flight, and thereby of events.
    mpsc::channel()
}
