//! Drives an incoming transfer: requests its pieces, stores and verifies them, and reports its progress.
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use super::{
    files::{StoreAction, StoreEvent, UsesFiles},
    progress_throttle::ProgressThrottle,
    ranges::Ranges,
    receiver::{PieceRequest, Receiver, Step as ReceiverStep},
    source, Checksum, Fault, Offer, Progress, Request, TransferId,
};
use crate::{
    driver::{Action, Driver, Event, Get, Id, Reaction, Step},
    message::{encoding::Encoding, payload::Payload, urgency::Urgency},
    name::key::KeySpace,
};

/// The interval at which the received ranges are saved.
const SAVE_EVERY: Duration = Duration::from_secs(2);
/// The timeout for notifying the sender that the transfer has ended.
const END_TIMEOUT: Duration = Duration::from_secs(3);

/// A transfer that is being received. Finishes when everything is stored and verified, or with the fault.
#[derive(Debug)]
pub struct TransferPull {
    receiver: Receiver,
    checksum: Checksum,
    /// The key at which the sender serves the pieces.
    key: String,
    requests: BTreeMap<Id, PieceRequest>,
    files: VecDeque<StoreAction>,
    is_checking: bool,
    saved_at: Instant,
    saved_bytes: u64,
    throttle: ProgressThrottle,
}

impl TransferPull {
    /// Creates the receiving end of a transfer, for a program of the robot of `place`. `held` is what was received before
    /// a restart. `timeout` is how long nothing may arrive before the transfer fails.
    pub fn new(
        place: &KeySpace,
        id: TransferId,
        offer: &Offer,
        held: Ranges,
        timeout: Duration,
        now: Instant,
    ) -> Self {
        let receiver = Receiver::new(now, offer.size_bytes, held, timeout);
        Self {
            checksum: offer.checksum,
            key: place.own(Some(&offer.sender), &source(id)),
            requests: BTreeMap::new(),
            files: VecDeque::new(),
            is_checking: false,
            saved_at: now,
            saved_bytes: receiver.progress().received_bytes,
            throttle: ProgressThrottle::default(),
            receiver,
        }
    }

    /// Handles that the sender has offered the transfer again.
    pub fn on_offered(&mut self, now: Instant) {
        self.receiver.on_offered(now);
    }

    /// Stops the transfer on behalf of the program.
    pub fn stop(&mut self) {
        self.receiver.end(Fault::Stopped);
    }

    /// Returns how much was received.
    pub fn progress(&self) -> Progress {
        self.receiver.progress()
    }

    /// Returns the ranges that were received.
    pub fn held(&self) -> &Ranges {
        self.receiver.held()
    }

    /// Returns the driver that notifies the sender of the end of this transfer.
    pub fn end_report(&self) -> EndReport {
        EndReport {
            key: self.key.clone(),
            is_sent: false,
            has_ended: false,
        }
    }

    fn request(&mut self, piece: PieceRequest) -> Action {
        let id = Id(piece.id);
        let payload = Payload::new(piece.request.encode(), Encoding::BYTES);
        let get = Get {
            payload: Some(payload),
            qos: Urgency::Bulk.qos(),
            // A late reply is of use, too.
            ..Get::new(self.key.clone(), piece.timeout * 2)
        };
        self.requests.insert(id, piece);
        Action::Get { id, get }
    }

    fn on_reply(&mut self, now: Instant, id: Id, reply: Result<Payload, Payload>) {
        // Only the first reply counts: an unlimited number could exhaust the memory.
        let Some(piece) = self.requests.remove(&id) else {
            return;
        };
        match reply {
            Ok(Payload { bytes, .. }) => {
                if self.receiver.on_reply(now, &piece, bytes.len() as u64) {
                    let at = piece.range.start;
                    self.files.push_back(StoreAction::Write { at, bytes });
                }
            }
            // Other errors are Zenoh's own, such as an expired timeout.
            Err(error) => {
                if let Some(fault) = Fault::decode(&error.bytes) {
                    self.receiver.on_fault(piece.id, fault);
                }
            }
        }
    }

    fn save_if_due(&mut self, now: Instant) {
        let received_bytes = self.receiver.progress().received_bytes;
        let is_due = now.saturating_duration_since(self.saved_at) >= SAVE_EVERY;
        if is_due && received_bytes != self.saved_bytes {
            let held = self.receiver.held().clone();
            self.files.push_back(StoreAction::Save(held));
            (self.saved_at, self.saved_bytes) = (now, received_bytes);
        }
    }
}

impl Driver for TransferPull {
    type Item = Progress;
    type Output = Result<(), Fault>;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Progress> {
        match event {
            Event::Reply { id, reply } => {
                self.on_reply(now, id, reply.map(|sample| sample.payload));
            }
            Event::Ended { id } => {
                self.requests.remove(&id);
                self.receiver.on_no_reply(now, id.0);
            }
            Event::Closed => self.stop(),
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Progress, Self::Output> {
        if let Some(progress) = self.throttle.poll(now, self.progress(), false) {
            return Step::Deliver(progress);
        }
        self.save_if_due(now);
        match self.receiver.poll(now) {
            ReceiverStep::Request(piece) => Step::Act(self.request(piece)),
            ReceiverStep::Wait(until) => Step::Wait(Some(until)),
            // `poll_file` asks for the checksum.
            ReceiverStep::Check => {
                if !std::mem::replace(&mut self.is_checking, true) {
                    self.files.push_back(StoreAction::Checksum);
                }
                Step::Wait(Some(now))
            }
            ReceiverStep::Finished(result) => {
                match self.throttle.poll(now, self.progress(), true) {
                    Some(progress) => Step::Deliver(progress),
                    None => Step::Finished(result),
                }
            }
        }
    }
}

impl UsesFiles for TransferPull {
    type Action = StoreAction;
    type Event = StoreEvent;

    fn poll_file(&mut self) -> Option<StoreAction> {
        self.files.pop_front()
    }

    fn on_file(&mut self, _now: Instant, event: StoreEvent) {
        match event {
            StoreEvent::Written { range, result } => match result {
                Ok(()) => self.receiver.on_written(range),
                Err(reason) => self.receiver.on_write_failed(reason),
            },
            StoreEvent::Checksum(result) => {
                self.is_checking = false;
                match result {
                    Ok(checksum) => self.receiver.on_checked(checksum == self.checksum),
                    Err(reason) => self.receiver.on_write_failed(reason),
                }
            }
            StoreEvent::Saved(Err(reason)) => self.receiver.on_write_failed(reason),
            StoreEvent::Saved(Ok(())) => {}
        }
    }
}

/// Notifies the sender that a transfer has ended, and finishes when it has received the outcome or cannot be reached.
#[derive(Debug)]
pub struct EndReport {
    key: String,
    is_sent: bool,
    has_ended: bool,
}

impl Driver for EndReport {
    type Item = std::convert::Infallible;
    type Output = ();

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Ended { .. } | Event::Closed => {
                self.has_ended = true;
                Reaction::POLL
            }
            _ => Reaction::NONE,
        }
    }

    fn poll(&mut self, _now: Instant) -> Step<Self::Item, ()> {
        if self.has_ended {
            return Step::Finished(());
        }
        if std::mem::replace(&mut self.is_sent, true) {
            return Step::Wait(None);
        }
        let get = Get {
            payload: Some(Payload::new(Request::Ended.encode(), Encoding::BYTES)),
            qos: Urgency::Bulk.qos(),
            ..Get::new(self.key.clone(), END_TIMEOUT)
        };
        let id = Id(0);
        Step::Act(Action::Get { id, get })
    }
}
