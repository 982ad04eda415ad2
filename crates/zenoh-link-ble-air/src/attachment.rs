//! Keeps track of an adapter's pending operations on the air, and dispatches the air's events to them. An
//! [`AirConnection`] transports the commands and events: within this process (`local`) or over a socket (`remote`).
use std::{collections::HashMap, sync::Arc};

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{mpsc, oneshot, watch};
use zenoh_link_ble_radio::{
    address::{DeviceAddress, Psm},
    interval::ConnectionInterval,
    AdapterState, AdvertisingReport, RadioError,
};

use super::{
    channel_flow::ChannelFlow,
    message::{
        ChannelId, Command, ConnectFailure, Event, ListenFailure, ReceivedAdvertisement, RequestId,
        SendLimits,
    },
    options::AirOptions,
};

/// Transports an adapter's commands to the air.
pub(super) trait AirConnection: Send + Sync {
    /// Sends a command. The command is lost if the air cannot be reached.
    fn command(&self, command: Command);

    /// Returns the error that explains why the adapter is missing.
    fn missing_error(&self, adapter: &str) -> RadioError;
}

/// The attachment of one adapter to the air, shared by the radio and everything created with it. The adapter is
/// detached when the last reference is dropped.
pub(super) struct Attachment {
    pub(super) name: String,
    pub(super) address: DeviceAddress,
    air: Box<dyn AirConnection>,
    pub(super) state: watch::Sender<AdapterState>,
    /// The default connection interval, and whether that of an open connection can be changed.
    intervals: Mutex<(ConnectionInterval, bool)>,
    /// Whether the first attempt to attach has completed.
    is_ready: watch::Sender<bool>,
    registrations: Mutex<Registrations>,
}

/// Maximum number of device names that are kept.
const MAX_NAMES: usize = 256;

/// Pending operations and open resources of the adapter.
#[derive(Default)]
pub(super) struct Registrations {
    last_request: u32,
    pub(super) scans: HashMap<RequestId, mpsc::Sender<AdvertisingReport>>,
    /// Names of the devices whose advertisements were received.
    names: HashMap<DeviceAddress, String>,
    pub(super) listening: HashMap<RequestId, oneshot::Sender<Result<OpenListener, ListenFailure>>>,
    listeners: HashMap<Psm, (RequestId, mpsc::UnboundedSender<OpenChannel>)>,
    pub(super) dials: HashMap<RequestId, PendingDial>,
    flows: HashMap<ChannelId, Arc<ChannelFlow>>,
}

/// One end of an open channel. Dropping it closes the channel.
pub(super) struct OpenChannel {
    pub(super) attachment: Arc<Attachment>,
    pub(super) id: ChannelId,
    pub(super) peer: DeviceAddress,
    pub(super) limits: SendLimits,
    pub(super) is_central: bool,
    pub(super) flow: Arc<ChannelFlow>,
}

impl Drop for OpenChannel {
    fn drop(&mut self) {
        self.attachment.end_channel(self.id, &self.flow);
    }
}

/// A listener and its incoming channels. Dropping it releases its PSM.
pub(super) struct OpenListener {
    pub(super) attachment: Arc<Attachment>,
    request: RequestId,
    pub(super) psm: Psm,
    pub(super) incoming: tokio::sync::Mutex<mpsc::UnboundedReceiver<OpenChannel>>,
}

impl Drop for OpenListener {
    fn drop(&mut self) {
        self.attachment.end_listener(self.request, self.psm);
    }
}

pub(super) struct PendingDial {
    pub(super) peer: DeviceAddress,
    pub(super) answer: oneshot::Sender<Result<OpenChannel, ConnectFailure>>,
}

impl Attachment {
    pub(super) fn new(name: &str, address: DeviceAddress, air: Box<dyn AirConnection>) -> Self {
        Self {
            name: name.to_owned(),
            address,
            air,
            state: watch::Sender::new(AdapterState::On),
            intervals: Mutex::new((
                ConnectionInterval::nearest(AirOptions::default().interval),
                true,
            )),
            is_ready: watch::Sender::new(true),
            registrations: Mutex::default(),
        }
    }

    /// Returns the attachment in the state before the first attempt to attach.
    pub(super) fn attaching(self) -> Self {
        self.state.send_replace(AdapterState::Missing);
        self.is_ready.send_replace(false);
        self
    }

    /// Records the connection interval that the air uses by default, and whether that of an open connection can be changed.
    pub(super) fn set_intervals(&self, default: ConnectionInterval, can_change: bool) {
        *self.intervals.lock() = (default, can_change);
    }

    pub(super) fn default_interval(&self) -> ConnectionInterval {
        self.intervals.lock().0
    }

    pub(super) fn changes_open_connections(&self) -> bool {
        self.intervals.lock().1
    }

    /// Marks the first attempt to attach as completed, successful or not.
    pub(super) fn set_ready(&self) {
        self.is_ready.send_replace(true);
    }

    pub(super) async fn wait_until_ready(&self) {
        // The sender lives as long as this borrow.
        let _ = self.is_ready.subscribe().wait_for(|is| *is).await;
    }

    /// Dispatches an event of the air. Called only by the task that receives the events, so that their order is
    /// preserved.
    pub(super) fn on_event(self: &Arc<Self>, event: Event) {
        match event {
            Event::State(state) => self.on_adapter_state(state),
            Event::AdvertisementReceived(received) => self.on_advertisement(received),
            Event::Listening { request, psm } => self.on_listening(request, psm),
            Event::Incoming {
                channel,
                psm,
                peer,
                limits,
                is_central,
            } => {
                let incoming = self.new_channel(channel, peer, limits, is_central);
                let listener = self.registrations.lock().listeners.get(&psm).cloned();
                // If there is no listener (any more), the channel is dropped, which closes it.
                if let Some((_, listener)) = listener {
                    let _ = listener.send(incoming);
                }
            }
            Event::Connected {
                request,
                channel,
                limits,
                is_central,
            } => {
                let dial = self.registrations.lock().dials.remove(&request);
                match dial {
                    Some(PendingDial { peer, answer }) => {
                        // If the caller no longer waits, the channel is dropped, which closes it.
                        let _ =
                            answer.send(Ok(self.new_channel(channel, peer, limits, is_central)));
                    }
                    None => self.command(Command::Close { channel }),
                }
            }
            Event::ConnectFailed { request, why } => {
                if let Some(dial) = self.registrations.lock().dials.remove(&request) {
                    let _ = dial.answer.send(Err(why));
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

    /// Applies a new state of the adapter. If the adapter is no longer on, all its operations end.
    pub(super) fn on_adapter_state(&self, state: AdapterState) {
        let mut registrations = self.registrations.lock();
        // Set while the lock is held, so that nothing is started on an adapter that has just been switched off.
        self.state
            .send_if_modified(|current| std::mem::replace(current, state) != state);
        if state == AdapterState::On {
            return;
        }
        let last_request = registrations.last_request;
        let previous = std::mem::replace(
            &mut *registrations,
            Registrations {
                last_request,
                ..Registrations::default()
            },
        );
        drop(registrations);
        for flow in previous.flows.values() {
            flow.on_closed();
        }
    }

    fn on_advertisement(&self, received: ReceivedAdvertisement) {
        let report = AdvertisingReport {
            device: received.device,
            advertisement: Some(received.advertisement),
            rssi_dbm: Some(received.rssi_dbm),
        };
        let mut registrations = self.registrations.lock();
        if registrations.names.len() >= MAX_NAMES {
            registrations.names.clear();
        }
        registrations.names.insert(received.device, received.name);
        for scan in registrations.scans.values() {
            let _ = scan.try_send(report.clone());
        }
    }

    pub(super) fn device_name(&self, device: DeviceAddress) -> Option<String> {
        self.registrations.lock().names.get(&device).cloned()
    }

    fn on_listening(self: &Arc<Self>, request: RequestId, psm: Result<Psm, ListenFailure>) {
        let listener = psm.map(|psm| {
            // Created here, so that it exists before the next event, which may be an incoming channel.
            let (sender, incoming) = mpsc::unbounded_channel();
            self.registrations
                .lock()
                .listeners
                .insert(psm, (request, sender));
            OpenListener {
                attachment: Arc::clone(self),
                request,
                psm,
                incoming: incoming.into(),
            }
        });
        let waiting = self.registrations.lock().listening.remove(&request);
        // If the caller no longer waits, the listener is dropped, which releases its PSM.
        if let Some(waiting) = waiting {
            let _ = waiting.send(listener);
        }
    }

    fn new_channel(
        self: &Arc<Self>,
        id: ChannelId,
        peer: DeviceAddress,
        limits: SendLimits,
        is_central: bool,
    ) -> OpenChannel {
        let flow = Arc::new(ChannelFlow::default());
        self.registrations
            .lock()
            .flows
            .insert(id, Arc::clone(&flow));
        OpenChannel {
            attachment: Arc::clone(self),
            id,
            peer,
            limits,
            is_central,
            flow,
        }
    }

    fn flow(&self, channel: ChannelId) -> Option<Arc<ChannelFlow>> {
        self.registrations.lock().flows.get(&channel).cloned()
    }

    pub(super) fn command(&self, command: Command) {
        self.air.command(command);
    }

    pub(super) fn state(&self) -> AdapterState {
        *self.state.borrow()
    }

    pub(super) fn registrations_if_on(&self) -> Result<MutexGuard<'_, Registrations>, RadioError> {
        let registrations = self.registrations.lock();
        match self.state() {
            AdapterState::On => Ok(registrations),
            AdapterState::Off | AdapterState::Missing => Err(self.unavailable()),
        }
    }

    /// Returns the error for an operation that ended or cannot start.
    pub(super) fn unavailable(&self) -> RadioError {
        match self.state() {
            AdapterState::Missing => self.air.missing_error(&self.name),
            // `On`: the adapter was off in between and is on again.
            AdapterState::Off | AdapterState::On => RadioError::AdapterOff {
                adapter: self.name.clone(),
            },
        }
    }

    /// Ends a listener, unless the loss of power already ended it.
    fn end_listener(&self, request: RequestId, psm: Psm) {
        let mut registrations = self.registrations.lock();
        if registrations
            .listeners
            .get(&psm)
            .is_some_and(|(r, _)| *r == request)
        {
            registrations.listeners.remove(&psm);
            drop(registrations);
            self.command(Command::Unlisten { psm });
        }
    }

    /// Cancels a connect.
    pub(super) fn end_dial(&self, request: RequestId) {
        let waiting = self.registrations.lock().dials.remove(&request);
        if waiting.is_some() {
            self.command(Command::CancelConnect { request });
        }
    }

    /// Closes and removes a channel, unless the adapter's state or the channel's owner already did.
    pub(super) fn end_channel(&self, id: ChannelId, flow: &Arc<ChannelFlow>) {
        let mut registrations = self.registrations.lock();
        // The id may already belong to another channel, if the air was restarted.
        if registrations
            .flows
            .get(&id)
            .is_some_and(|current| Arc::ptr_eq(current, flow))
        {
            registrations.flows.remove(&id);
            drop(registrations);
            self.command(Command::Close { channel: id });
        }
    }

    /// Ends a scan. The air stops scanning if it was the last one.
    pub(super) fn end_scan(&self, request: RequestId) {
        let was_last = {
            let mut registrations = self.registrations.lock();
            registrations.scans.remove(&request).is_some() && registrations.scans.is_empty()
        };
        if was_last {
            self.command(Command::Scan(false));
            // Another scan may have started just before the command.
            if !self.registrations.lock().scans.is_empty() {
                self.command(Command::Scan(true));
            }
        }
    }
}

impl Registrations {
    pub(super) fn next_request(&mut self) -> RequestId {
        self.last_request = self.last_request.wrapping_add(1);
        RequestId(self.last_request)
    }
}
