//! Keeps what all listeners and dials of one Zenoh runtime share: the identity of the node, its links and its adapters.
use std::{
    collections::HashMap,
    sync::{Arc, Weak},
    time::Duration,
};

use link_lanes::{hello::NodeId, secret::Secret};
use parking_lot::{Mutex, MutexGuard};
use tokio::{sync::Notify, time::Instant};
use tokio_util::sync::CancellationToken;
use zenoh_link_ble_radio::{
    address::DeviceAddress,
    interval::ConnectionInterval,
    interval_table::{Action, IntervalTable, Intervals},
    Radio, RadioError,
};
use zenoh_link_commons::NewLinkChannelSender;

use crate::{
    adapter::Adapter,
    link::{
        history::History,
        number::LinkNumber,
        open_links::OpenLinks,
        path::AcceptPaths,
        status::{LinkUsage, NodeStatus},
        table::LinkTable,
        LinkBle,
    },
    refusals::Refusals,
    rejected_peers::RejectedPeers,
};

/// Opens the radio with that name, or the system's default one if the name is `None`.
pub(crate) type OpenRadio =
    dyn Fn(Option<&str>) -> Result<Arc<dyn Radio>, RadioError> + Send + Sync;

/// The shared state of one Zenoh runtime's `ble` links.
pub(crate) struct Node {
    pub(crate) id: NodeId,
    /// Channel on which Zenoh takes accepted links; the same for all link managers of a runtime.
    pub(crate) new_links: NewLinkChannelSender,
    link_table: Mutex<LinkTable>,
    intervals: Mutex<IntervalTable<LinkNumber>>,
    /// Cancelled when the node must not dial any more.
    pub(crate) stop_dialling: CancellationToken,
    /// Notified whenever a link or a dial ends.
    pub(crate) link_ended: Notify,
    adapters: Mutex<HashMap<String, Arc<Adapter>>>,
    identities: Mutex<Vec<ListenerIdentity>>,
    history: Mutex<History>,
    rejected_peers: Mutex<RejectedPeers>,
    refusals: Mutex<Refusals>,
    /// Devices that have opened a channel and are neither linked nor refused yet.
    handshaking: Mutex<Vec<DeviceAddress>>,
    /// Notified whenever a handshake with one of them ends.
    handshake_ended: Notify,
    open_links: Mutex<OpenLinks>,
    open_radio: Box<OpenRadio>,
    path_acceptor: Mutex<Option<Weak<dyn AcceptPaths>>>,
}

/// The properties of this node's listener that a dial uses: its adapter, its name and its secret.
#[derive(Clone)]
pub(crate) struct ListenerIdentity {
    pub adapter: String,
    pub name: String,
    pub secret: Option<Secret>,
}

impl Node {
    pub(crate) fn new(
        id: NodeId,
        new_links: NewLinkChannelSender,
        open_radio: Box<OpenRadio>,
    ) -> Arc<Self> {
        Arc::new(Self {
            id,
            new_links,
            link_table: Mutex::new(LinkTable::new(id)),
            intervals: Mutex::default(),
            stop_dialling: CancellationToken::new(),
            link_ended: Notify::new(),
            adapters: Mutex::default(),
            identities: Mutex::default(),
            history: Mutex::default(),
            rejected_peers: Mutex::default(),
            refusals: Mutex::default(),
            handshaking: Mutex::default(),
            handshake_ended: Notify::new(),
            open_links: Mutex::default(),
            open_radio,
            path_acceptor: Mutex::new(None),
        })
    }

    /// Sets the part of the program that takes channels which become paths of other links.
    pub(crate) fn set_path_acceptor(&self, acceptor: &Arc<dyn AcceptPaths>) {
        *self.path_acceptor.lock() = Some(Arc::downgrade(acceptor));
    }

    /// Returns what takes channels which become paths of other links, if there is any.
    pub(crate) fn path_acceptor(&self) -> Option<Arc<dyn AcceptPaths>> {
        self.path_acceptor.lock().as_ref()?.upgrade()
    }

    /// Locks the table of links and dials.
    pub(crate) fn link_table(&self) -> MutexGuard<'_, LinkTable> {
        self.link_table.lock()
    }

    /// Locks the table of connection intervals.
    pub(crate) fn intervals(&self) -> MutexGuard<'_, IntervalTable<LinkNumber>> {
        self.intervals.lock()
    }

    /// Sets the connection interval for the next connection to a peer. Returns it with the intervals that the link must
    /// avoid, or `None` if the radio does not permit it.
    pub(crate) async fn request_interval(
        &self,
        radio: &dyn Radio,
        peer: DeviceAddress,
    ) -> Option<Intervals> {
        let intervals = self.intervals().for_dial(peer, radio.default_interval());
        let is_set = radio.set_interval(peer, intervals.requested?).await;
        is_set.then_some(intervals)
    }

    /// Performs an action of the table of connection intervals, in a task of its own.
    pub(crate) fn perform(&self, action: Option<Action<LinkNumber>>) {
        let Some(action) = action else {
            return;
        };
        let (Action::Change(number, interval)
        | Action::Announce(number, interval)
        | Action::Request(number, interval)) = action;
        let Some(link) = self.open_links.lock().get(number) else {
            return;
        };
        match action {
            Action::Change(..) => {
                tokio::spawn(async move { link.set_interval(interval).await });
            }
            Action::Announce(..) | Action::Request(..) => link.send_interval(interval),
        }
    }

    /// Performs the actions that the table of connection intervals has for a new link.
    pub(crate) fn perform_for_new_link(&self) {
        let action = self.intervals().next_action();
        self.perform(action);
        if let Some(Action::Announce(..)) = action {
            let action = self.intervals().next_action();
            self.perform(action);
        }
    }

    /// Records a new link in the history and in the list of open links.
    pub(crate) fn on_link_open(&self, number: LinkNumber, peer: &str, link: &Arc<LinkBle>) {
        self.history.lock().on_linked(peer);
        self.open_links.lock().add(number, link);
    }

    /// Records the end of a link in the history, and removes the link.
    pub(crate) fn on_link_ended(&self, number: LinkNumber, peer: &str, reason: &str) {
        self.history
            .lock()
            .on_ended(peer, reason, Instant::now().into_std());
        self.on_link_closed(number);
    }

    /// Records a failed dial in the history.
    pub(crate) fn on_failed_dial(&self, target: &str, reason: &str) {
        let mut history = self.history.lock();
        history.on_failed_dial(target, reason, Instant::now().into_std());
    }

    /// Records that a device has opened a channel. The handshake ends when the returned guard is dropped.
    pub(crate) fn begin_handshake(self: &Arc<Self>, device: DeviceAddress) -> HandshakeGuard {
        self.handshaking.lock().push(device);
        HandshakeGuard {
            node: Arc::clone(self),
            device,
        }
    }

    /// Waits until no handshake with that device is in progress. A channel that is requested during a handshake may cross
    /// the channel of the device: see [`BleError::Misdirected`](crate::BleError::Misdirected).
    pub(crate) async fn wait_for_handshakes_with(&self, device: DeviceAddress) {
        loop {
            let handshake_ended = self.handshake_ended.notified();
            if !self.handshaking.lock().contains(&device) {
                return;
            }
            handshake_ended.await;
        }
    }

    /// Records that a device asked for a link and got none, and logs it unless it has been logged recently.
    pub(crate) fn on_refused(&self, device: DeviceAddress, reason: &str) {
        let now = Instant::now().into_std();
        let line = self.refusals.lock().on_refused(device, reason, now);
        if let Some(line) = line {
            tracing::warn!("ble: {line}");
        }
    }

    /// Records that a device that asked for a link got one.
    pub(crate) fn on_accepted(&self, device: DeviceAddress) {
        self.refusals.lock().on_linked(device);
    }

    /// Records that a device did not prove the secret.
    pub(crate) fn on_rejected(&self, device: DeviceAddress) {
        let now = Instant::now().into_std();
        self.rejected_peers.lock().insert(device, now);
    }

    /// Returns whether a device did not prove the secret recently.
    pub(crate) fn is_rejected(&self, device: DeviceAddress) -> bool {
        let now = Instant::now().into_std();
        self.rejected_peers.lock().contains(device, now)
    }

    /// Returns the state of the node's links and peers.
    pub(crate) fn status(&self) -> NodeStatus {
        let links = self.open_links.lock().all();
        let adapters: Vec<_> = self.adapters.lock().values().cloned().collect();
        NodeStatus {
            name: self.name(),
            links: links.iter().map(|link| link.status()).collect(),
            peers: self.history.lock().status(Instant::now().into_std()),
            refused: self.refusals.lock().status(Instant::now().into_std()),
            discovered: (adapters.iter())
                .flat_map(|adapter| adapter.scanner.discovered())
                .collect(),
        }
    }

    /// Returns what the node's links have sent for each key.
    pub(crate) fn usage(&self, keep: Duration) -> Vec<LinkUsage> {
        let links = self.open_links.lock().all();
        links.iter().filter_map(|link| link.usage(keep)).collect()
    }

    /// Removes a link, and notifies the dials that wait for its end.
    pub(crate) fn on_link_closed(&self, link: LinkNumber) {
        self.link_table().on_closed(link);
        self.intervals().on_ended(link);
        self.open_links.lock().remove(link);
        // Earlier advertisements are outdated: the peer may be out of range, and a connect would wait for it.
        for adapter in self.adapters.lock().values() {
            adapter.scanner.clear_recent();
        }
        self.link_ended.notify_waiters();
    }

    /// Returns the adapter with that name. Without a name, it is the one that this node listens on, or else the system's
    /// default.
    pub(crate) fn adapter(&self, name: Option<&str>) -> Result<Arc<Adapter>, RadioError> {
        let default = self.identities.lock().first().map(|l| l.adapter.clone());
        let name = name.map(str::to_owned).or(default);
        let mut adapters = self.adapters.lock();
        let key = name.clone().unwrap_or_default();
        if let Some(adapter) = adapters.get(&key) {
            return Ok(Arc::clone(adapter));
        }
        let adapter = Adapter::new((self.open_radio)(name.as_deref())?);
        adapters.insert(key, Arc::clone(&adapter));
        Ok(adapter)
    }

    /// Records that this node listens.
    pub(crate) fn on_listening(&self, identity: ListenerIdentity) {
        self.identities.lock().push(identity);
    }

    /// Records that this node does not listen on an adapter any more.
    pub(crate) fn on_listening_ended(&self, adapter: &str) {
        self.identities.lock().retain(|l| l.adapter != adapter);
    }

    /// Returns the name that this node uses when it dials: that of its listener, or an empty one if it does not listen.
    pub(crate) fn name(&self) -> String {
        self.identities
            .lock()
            .first()
            .map_or_else(String::new, |l| l.name.clone())
    }

    /// Returns the secret that a dialled peer must have if the locator gives none: that of this node's listener.
    pub(crate) fn secret(&self) -> Option<Secret> {
        (self.identities.lock().first()).and_then(|l| l.secret.clone())
    }

    /// Returns the number that distinguishes the advertisements of this run from those of an earlier one.
    pub(crate) fn incarnation(&self) -> u16 {
        (self.id.0 & 0xffff) as u16
    }
}

/// Sets the interval of the connection to a peer if the handshake led to another one than this node, as the central, had
/// requested. The peer has computed the same interval.
pub(crate) async fn set_if_changed(
    radio: &dyn Radio,
    peer: DeviceAddress,
    own: Option<Intervals>,
    interval: Option<ConnectionInterval>,
) {
    let requested = own.and_then(|own| own.requested);
    if let Some(interval) = interval.filter(|_| requested.is_some() && requested != interval) {
        radio.set_interval(peer, interval).await;
    }
}

/// A handshake with a device that has opened a channel. Dropping the guard ends the handshake.
pub(crate) struct HandshakeGuard {
    node: Arc<Node>,
    device: DeviceAddress,
}

impl Drop for HandshakeGuard {
    fn drop(&mut self) {
        let mut handshaking = self.node.handshaking.lock();
        if let Some(at) = handshaking.iter().position(|device| *device == self.device) {
            handshaking.swap_remove(at);
        }
        drop(handshaking);
        self.node.handshake_ended.notify_waiters();
    }
}
