//! Owns the simulated adapter as the link sees it: [`SimRadio`] implements [`Radio`] by telling the air what it is
//! asked, and by sorting what the air says to those who wait for it.
//!
//! How commands and events travel is a [`Carrier`]'s business: in this process (`local`) or over a socket (`remote`).
use std::{
    collections::HashMap,
    future::Future,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use async_trait::async_trait;
use tokio::sync::{mpsc, oneshot, watch};

use super::{
    channel_handle::{ChannelFlow, SimChannel},
    guards::{Advertised, CancelOnDrop, SimListener, SimScan},
    message::{ChannelId, Command, ConnectFailure, Event, Heard, ListenFailure, RequestId},
    options::{MAX_NAME_BYTES, MIN_MTU},
};
use crate::{
    address::{DeviceAddress, Psm},
    advertisement::Advertisement,
    radio::{
        AdapterState, AdvertisingGuard, Channel, ChannelListener, ChannelOptions, Radio,
        RadioError, Scan, Sighting,
    },
};

/// Sightings that wait for a slow scan; what comes beyond is not heard, as on a real radio.
const SCAN_QUEUE: usize = 256;

/// How an adapter's commands get to the air.
pub(super) trait Carrier: Send + Sync {
    /// Sends a command; it is lost when the air is not there.
    fn command(&self, command: Command);

    /// Why the adapter is missing.
    fn absence(&self, adapter: &str) -> RadioError;
}

/// A simulated Bluetooth adapter.
pub struct SimRadio {
    pub(super) attachment: Arc<Attachment>,
}

/// An adapter's place on the air, shared by the radio and all that was made with it. It goes when the last goes.
pub(super) struct Attachment {
    pub(super) name: String,
    pub(super) address: DeviceAddress,
    carrier: Box<dyn Carrier>,
    state: watch::Sender<AdapterState>,
    /// Whether the first attempt to attach is over.
    is_ready: watch::Sender<bool>,
    book: Mutex<Book>,
}

/// Who waits for what.
#[derive(Default)]
struct Book {
    last_request: u32,
    scans: HashMap<RequestId, mpsc::Sender<Sighting>>,
    listening: HashMap<RequestId, oneshot::Sender<Result<SimListener, ListenFailure>>>,
    listeners: HashMap<Psm, (RequestId, mpsc::UnboundedSender<SimChannel>)>,
    dials: HashMap<RequestId, Dialling>,
    flows: HashMap<ChannelId, Arc<ChannelFlow>>,
}

struct Dialling {
    peer: DeviceAddress,
    answer: oneshot::Sender<Result<SimChannel, ConnectFailure>>,
}

#[async_trait]
impl Radio for SimRadio {
    fn name(&self) -> &str {
        &self.attachment.name
    }

    async fn address(&self) -> Result<DeviceAddress, RadioError> {
        self.attachment.until_ready().await;
        match self.attachment.state() {
            AdapterState::Missing => Err(self.attachment.unavailable()),
            AdapterState::Off | AdapterState::On => Ok(self.attachment.address),
        }
    }

    async fn state(&self) -> AdapterState {
        self.attachment.until_ready().await;
        self.attachment.state()
    }

    // Not an `async fn`: it counts changes from the call, not from the first poll.
    fn changed<'life0, 'async_trait>(
        &'life0 self,
    ) -> Pin<Box<dyn Future<Output = ()> + Send + 'async_trait>>
    where
        'life0: 'async_trait,
        Self: 'async_trait,
    {
        let mut state = self.attachment.state.subscribe();
        Box::pin(async move {
            // The sender lives as long as this borrow of the radio.
            let _ = state.changed().await;
        })
    }

    async fn advertise(
        &self,
        advertisement: &Advertisement,
        name: &str,
    ) -> Result<Box<dyn AdvertisingGuard>, RadioError> {
        let attachment = &self.attachment;
        attachment.until_ready().await;
        let request = attachment.book_if_on()?.next_request();
        attachment.command(Command::Advertise {
            request,
            advertisement: *advertisement,
            name: shortened(name).to_owned(),
        });
        Ok(Box::new(Advertised {
            attachment: Arc::clone(attachment),
            request,
        }))
    }

    async fn scan(&self) -> Result<Box<dyn Scan>, RadioError> {
        let attachment = &self.attachment;
        attachment.until_ready().await;
        let (sender, heard) = mpsc::channel(SCAN_QUEUE);
        let request = {
            let mut book = attachment.book_if_on()?;
            let request = book.next_request();
            book.scans.insert(request, sender);
            request
        };
        attachment.command(Command::Scan(true));
        Ok(Box::new(SimScan {
            attachment: Arc::clone(attachment),
            request,
            heard,
        }))
    }

    async fn listen(
        &self,
        psm: Option<Psm>,
        options: ChannelOptions,
    ) -> Result<Box<dyn ChannelListener>, RadioError> {
        let attachment = &self.attachment;
        attachment.until_ready().await;
        let (sender, answer) = oneshot::channel();
        let request = {
            let mut book = attachment.book_if_on()?;
            let request = book.next_request();
            book.listening.insert(request, sender);
            request
        };
        attachment.command(Command::Listen {
            request,
            psm,
            recv_mtu: options.recv_mtu.max(MIN_MTU),
        });
        match answer.await {
            Ok(Ok(listener)) => Ok(Box::new(listener)),
            Ok(Err(ListenFailure::Taken)) => match psm {
                Some(psm) => Err(RadioError::PsmTaken(psm)),
                None => Err(attachment.unavailable()),
            },
            Ok(Err(ListenFailure::NoneFree)) => Err(RadioError::System {
                action: "choosing a psm",
                source: "all 128 of this adapter are taken".into(),
            }),
            Ok(Err(ListenFailure::Unavailable)) | Err(_) => Err(attachment.unavailable()),
        }
    }

    async fn connect(
        &self,
        peer: DeviceAddress,
        psm: Psm,
        options: ChannelOptions,
    ) -> Result<Arc<dyn Channel>, RadioError> {
        let attachment = &self.attachment;
        attachment.until_ready().await;
        let (sender, answer) = oneshot::channel();
        let request = {
            let mut book = attachment.book_if_on()?;
            let request = book.next_request();
            let dialling = Dialling {
                peer,
                answer: sender,
            };
            book.dials.insert(request, dialling);
            request
        };
        attachment.command(Command::Connect {
            request,
            peer,
            psm,
            recv_mtu: options.recv_mtu.max(MIN_MTU),
        });
        let mut cancel = CancelOnDrop::new(Arc::clone(attachment), request);
        let answered = answer.await;
        cancel.disarm();
        match answered {
            Ok(Ok(channel)) => Ok(Arc::new(channel)),
            Ok(Err(ConnectFailure::Refused)) => Err(RadioError::Refused { peer, psm }),
            Ok(Err(ConnectFailure::LinkLost)) => Err(RadioError::ChannelDown {
                peer,
                source: Some(std::io::ErrorKind::ConnectionAborted.into()),
            }),
            Ok(Err(ConnectFailure::Unavailable)) | Err(_) => Err(attachment.unavailable()),
        }
    }
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

    async fn until_ready(&self) {
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
                send_mtu,
            } => {
                let incoming = self.opened(channel, peer, send_mtu);
                let listener = self.book().listeners.get(&psm).cloned();
                // Without a listener (any more) the channel is dropped, which closes it.
                if let Some((_, listener)) = listener {
                    let _ = listener.send(incoming);
                }
            }
            Event::Connected {
                request,
                channel,
                send_mtu,
            } => {
                let dialling = self.book().dials.remove(&request);
                match dialling {
                    Some(Dialling { peer, answer }) => {
                        // Dropped, and so closed, when nobody waits any more.
                        let _ = answer.send(Ok(self.opened(channel, peer, send_mtu)));
                    }
                    None => self.command(Command::Close { channel }),
                }
            }
            Event::ConnectFailed { request, why } => {
                if let Some(dialling) = self.book().dials.remove(&request) {
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
        let mut book = self.book();
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
        for scan in self.book().scans.values() {
            let _ = scan.try_send(sighting.clone());
        }
    }

    fn on_listening(self: &Arc<Self>, request: RequestId, psm: Result<Psm, ListenFailure>) {
        let listener = psm.map(|psm| {
            // Made here, so that it is there before the next event, which may be a call.
            let (sender, calls) = mpsc::unbounded_channel();
            self.book().listeners.insert(psm, (request, sender));
            SimListener::new(Arc::clone(self), request, psm, calls)
        });
        let waiting = self.book().listening.remove(&request);
        // A listener that nobody waits for any more is dropped, which gives its PSM back.
        if let Some(waiting) = waiting {
            let _ = waiting.send(listener);
        }
    }

    fn opened(self: &Arc<Self>, id: ChannelId, peer: DeviceAddress, send_mtu: u16) -> SimChannel {
        let flow = Arc::new(ChannelFlow::default());
        self.book().flows.insert(id, Arc::clone(&flow));
        SimChannel::new(Arc::clone(self), id, peer, usize::from(send_mtu), flow)
    }

    fn flow(&self, channel: ChannelId) -> Option<Arc<ChannelFlow>> {
        self.book().flows.get(&channel).cloned()
    }

    pub(super) fn command(&self, command: Command) {
        self.carrier.command(command);
    }

    fn state(&self) -> AdapterState {
        *self.state.borrow()
    }

    fn book_if_on(&self) -> Result<MutexGuard<'_, Book>, RadioError> {
        let book = self.book();
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
        let mut book = self.book();
        if book.listeners.get(&psm).is_some_and(|(r, _)| *r == request) {
            book.listeners.remove(&psm);
            drop(book);
            self.command(Command::Unlisten { psm });
        }
    }

    /// Takes a connect back.
    pub(super) fn end_dial(&self, request: RequestId) {
        let waiting = self.book().dials.remove(&request);
        if waiting.is_some() {
            self.command(Command::CancelConnect { request });
        }
    }

    /// Forgets a channel and closes it, unless the adapter's power or its owner did.
    pub(super) fn end_channel(&self, id: ChannelId, flow: &Arc<ChannelFlow>) {
        let mut book = self.book();
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
            let mut book = self.book();
            book.scans.remove(&request).is_some() && book.scans.is_empty()
        };
        if was_last {
            self.command(Command::Scan(false));
            // Another may have begun just before that.
            if !self.book().scans.is_empty() {
                self.command(Command::Scan(true));
            }
        }
    }

    // Nothing panics while it holds the book, and a book left by a panic is still in order.
    fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Book {
    fn next_request(&mut self) -> RequestId {
        self.last_request = self.last_request.wrapping_add(1);
        RequestId(self.last_request)
    }
}

/// A name as far as the scan response has room for it.
fn shortened(name: &str) -> &str {
    let mut end = name.len().min(MAX_NAME_BYTES);
    while !name.is_char_boundary(end) {
        end -= 1;
    }
    &name[..end]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_name_is_shortened_between_characters() {
        assert_eq!(shortened("wombat-1"), "wombat-1");
        let long = "ä".repeat(20);
        assert_eq!(shortened(&long), "ä".repeat(14));
    }
}
