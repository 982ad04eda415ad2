//! Owns an adapter's place on the air: who waits for what, and the sorting of what the air says to them. How commands
//! and events travel is a [`Carrier`]'s business: in this process (`local`) or over a socket (`remote`).
use std::{collections::HashMap, sync::Arc};

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{mpsc, oneshot, watch};

use super::{
    channel_handle::{ChannelFlow, SimChannel},
    guards::SimListener,
    message::{
        ChannelId, Command, ConnectFailure, Event, Heard, ListenFailure, RequestId, SendLimits,
    },
};
use crate::{
    address::{DeviceAddress, Psm},
    radio::{AdapterState, RadioError, Sighting},
};

/// How an adapter's commands get to the air.
pub(super) trait Carrier: Send + Sync {
    /// Sends a command; it is lost when the air is not there.
    fn command(&self, command: Command);

    /// Why the adapter is missing.
    fn absence(&self, adapter: &str) -> RadioError;
}

/// An adapter's place on the air, shared by the radio and all that was made with it. It goes when the last goes.
pub(super) struct Attachment {
    pub(super) name: String,
    pub(super) address: DeviceAddress,
    carrier: Box<dyn Carrier>,
    pub(super) state: watch::Sender<AdapterState>,
    /// Whether the first attempt to attach is over.
    is_ready: watch::Sender<bool>,
    book: Mutex<Book>,
}

/// How many devices' names are remembered.
const MAX_NAMES: usize = 256;

/// Who waits for what.
#[derive(Default)]
pub(super) struct Book {
    last_request: u32,
    pub(super) scans: HashMap<RequestId, mpsc::Sender<Sighting>>,
    /// What devices that were heard call themselves.
    names: HashMap<DeviceAddress, String>,
    pub(super) listening: HashMap<RequestId, oneshot::Sender<Result<SimListener, ListenFailure>>>,
    listeners: HashMap<Psm, (RequestId, mpsc::UnboundedSender<SimChannel>)>,
    pub(super) dials: HashMap<RequestId, Dialling>,
    flows: HashMap<ChannelId, Arc<ChannelFlow>>,
}

pub(super) struct Dialling {
    pub(super) peer: DeviceAddress,
    pub(super) answer: oneshot::Sender<Result<SimChannel, ConnectFailure>>,
}

impl Attachment {
    pub(super) fn new(name: &str, address: DeviceAddress, carrier: Box<dyn Carrier>) -> Self {
        Self {
            name: name.to_owned(),
            address,
            carrier,
            state: watch::Sender::new(AdapterState::On),
            is_ready: watch::Sender::new(true),
            book: Mutex::default(),
        }
    }

    /// The same while it is being attached.
    pub(super) fn not_yet(self) -> Self {
        self.state.send_replace(AdapterState::Missing);
        self.is_ready.send_replace(false);
        self
    }

    /// The first attempt to attach is over, well or not.
    pub(super) fn ready(&self) {
        self.is_ready.send_replace(true);
    }

    pub(super) async fn until_ready(&self) {
        // The sender lives as long as this borrow.
        let _ = self.is_ready.subscribe().wait_for(|is| *is).await;
    }

    /// Sorts what the air says. Called by the carrier's task only, so events keep their order.
    pub(super) fn on_event(self: &Arc<Self>, event: Event) {
        match event {
            Event::State(state) => self.on_state(state),
            Event::Sighting(heard) => self.on_heard(heard),
            Event::Listening { request, psm } => self.on_listening(request, psm),
            Event::Incoming {
                channel,
                psm,
                peer,
                limits,
            } => {
                let incoming = self.opened(channel, peer, limits);
                let listener = self.book.lock().listeners.get(&psm).cloned();
                // Without a listener (any more) the channel is dropped, which closes it.
                if let Some((_, listener)) = listener {
                    let _ = listener.send(incoming);
                }
            }
            Event::Connected {
                request,
                channel,
                limits,
            } => {
                let dialling = self.book.lock().dials.remove(&request);
                match dialling {
                    Some(Dialling { peer, answer }) => {
                        // Dropped, and so closed, when nobody waits any more.
                        let _ = answer.send(Ok(self.opened(channel, peer, limits)));
                    }
                    None => self.command(Command::Close { channel }),
                }
            }
            Event::ConnectFailed { request, why } => {
                if let Some(dialling) = self.book.lock().dials.remove(&request) {
                    let _ = dialling.answer.send(Err(why));
                }
            }
            Event::Sent { channel, bytes } => {
                if let Some(flow) = self.flow(channel) {
                    flow.on_sent(bytes);
                }
            }
            Event::Received { channel, sdu } => {
                if let Some(flow) = self.flow(channel) {
                    flow.on_received(sdu);
                }
            }
            Event::Closed { channel } => {
                if let Some(flow) = self.flow(channel) {
                    flow.on_closed();
                }
            }
        }
    }

    /// The adapter's state changed; without power all that it did is over.
    pub(super) fn on_state(&self, state: AdapterState) {
        let mut book = self.book.lock();
        // Told while the book is held, so that nothing begins on an adapter that has just gone.
        self.state
            .send_if_modified(|there| std::mem::replace(there, state) != state);
        if state == AdapterState::On {
            return;
        }
        let last_request = book.last_request;
        let ended = std::mem::replace(
            &mut *book,
            Book {
                last_request,
                ..Book::default()
            },
        );
        drop(book);
        for flow in ended.flows.values() {
            flow.on_closed();
        }
    }

    fn on_heard(&self, heard: Heard) {
        let sighting = Sighting {
            device: heard.device,
            advertisement: Some(heard.advertisement),
            rssi_dbm: Some(heard.rssi_dbm),
        };
        let mut book = self.book.lock();
        if book.names.len() >= MAX_NAMES {
            book.names.clear();
        }
        book.names.insert(heard.device, heard.name);
        for scan in book.scans.values() {
            let _ = scan.try_send(sighting.clone());
        }
    }

    pub(super) fn name_of(&self, device: DeviceAddress) -> Option<String> {
        self.book.lock().names.get(&device).cloned()
    }

    fn on_listening(self: &Arc<Self>, request: RequestId, psm: Result<Psm, ListenFailure>) {
        let listener = psm.map(|psm| {
            // Made here, so that it is there before the next event, which may be a call.
            let (sender, calls) = mpsc::unbounded_channel();
            self.book.lock().listeners.insert(psm, (request, sender));
            SimListener::new(Arc::clone(self), request, psm, calls)
        });
        let waiting = self.book.lock().listening.remove(&request);
        // A listener that nobody waits for any more is dropped, which gives its PSM back.
        if let Some(waiting) = waiting {
            let _ = waiting.send(listener);
        }
    }

    fn opened(
        self: &Arc<Self>,
        id: ChannelId,
        peer: DeviceAddress,
        limits: SendLimits,
    ) -> SimChannel {
        let flow = Arc::new(ChannelFlow::default());
        self.book.lock().flows.insert(id, Arc::clone(&flow));
        SimChannel::new(Arc::clone(self), id, peer, limits, flow)
    }

    fn flow(&self, channel: ChannelId) -> Option<Arc<ChannelFlow>> {
        self.book.lock().flows.get(&channel).cloned()
    }

    pub(super) fn command(&self, command: Command) {
        self.carrier.command(command);
    }

    pub(super) fn state(&self) -> AdapterState {
        *self.state.borrow()
    }

    pub(super) fn book_if_on(&self) -> Result<MutexGuard<'_, Book>, RadioError> {
        let book = self.book.lock();
        match self.state() {
            AdapterState::On => Ok(book),
            AdapterState::Off | AdapterState::Missing => Err(self.unavailable()),
        }
    }

    /// Why something ended, or cannot begin.
    pub(super) fn unavailable(&self) -> RadioError {
        match self.state() {
            AdapterState::Missing => self.carrier.absence(&self.name),
            // On again already: it was off in between.
            AdapterState::Off | AdapterState::On => RadioError::AdapterOff {
                adapter: self.name.clone(),
            },
        }
    }

    /// Ends a listener, unless the adapter's power did.
    pub(super) fn end_listener(&self, request: RequestId, psm: Psm) {
        let mut book = self.book.lock();
        if book.listeners.get(&psm).is_some_and(|(r, _)| *r == request) {
            book.listeners.remove(&psm);
            drop(book);
            self.command(Command::Unlisten { psm });
        }
    }

    /// Takes a connect back.
    pub(super) fn end_dial(&self, request: RequestId) {
        let waiting = self.book.lock().dials.remove(&request);
        if waiting.is_some() {
            self.command(Command::CancelConnect { request });
        }
    }

    /// Forgets a channel and closes it, unless the adapter's power or its owner did.
    pub(super) fn end_channel(&self, id: ChannelId, flow: &Arc<ChannelFlow>) {
        let mut book = self.book.lock();
        // The number may be another channel's by now, if the air was started anew.
        if book
            .flows
            .get(&id)
            .is_some_and(|there| Arc::ptr_eq(there, flow))
        {
            book.flows.remove(&id);
            drop(book);
            self.command(Command::Close { channel: id });
        }
    }

    /// Ends a scan; the air is told when it was the last.
    pub(super) fn end_scan(&self, request: RequestId) {
        let was_last = {
            let mut book = self.book.lock();
            book.scans.remove(&request).is_some() && book.scans.is_empty()
        };
        if was_last {
            self.command(Command::Scan(false));
            // Another may have begun just before that.
            if !self.book.lock().scans.is_empty() {
                self.command(Command::Scan(true));
            }
        }
    }
}

impl Book {
    pub(super) fn next_request(&mut self) -> RequestId {
        self.last_request = self.last_request.wrapping_add(1);
        RequestId(self.last_request)
    }
}
