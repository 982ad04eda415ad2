//! Owns what all listeners and dials of one Zenoh runtime share: who this node is, its links, its adapters.
use std::{collections::HashMap, sync::Arc, time::Duration};

use parking_lot::{Mutex, MutexGuard};
use tokio::{sync::Notify, time::Instant};
use tokio_util::sync::CancellationToken;
use zenoh_link_commons::NewLinkChannelSender;

use crate::{
    adapter::Adapter,
    address::DeviceAddress,
    hello::NodeId,
    history::History,
    link::LinkBle,
    links::{LinkNumber, Links},
    pause::Pause,
    radio::{Radio, RadioError},
    secret::Secret,
    status::{NodeStatus, OpenLinks},
    strangers::Strangers,
};

/// How long a link waits at most for those before it, should they end one after the other. Zenoh's own limit for opening
/// a link is 10 s.
const LONGEST_PAUSE: Duration = Duration::from_secs(3);

/// Opens the radio of that name (`None`: the system's default one).
pub(crate) type OpenRadio =
    dyn Fn(Option<&str>) -> Result<Arc<dyn Radio>, RadioError> + Send + Sync;

pub(crate) struct Node {
    pub(crate) id: NodeId,
    /// Where Zenoh takes new links: the same channel for all that one runtime makes.
    pub(crate) new_links: NewLinkChannelSender,
    links: Mutex<Links>,
    /// Cancelled when this node is to dial nobody any more.
    pub(crate) stop_dialling: CancellationToken,
    /// Told whenever a link ends.
    pub(crate) unlinked: Notify,
    /// Told whenever Zenoh has let go of one.
    released: Notify,
    adapters: Mutex<HashMap<String, Arc<Adapter>>>,
    listening: Mutex<Vec<Listening>>,
    history: Mutex<History>,
    strangers: Mutex<Strangers>,
    /// Who has opened a channel and is not linked or refused yet.
    greeted: Mutex<Vec<DeviceAddress>>,
    /// Told whenever one of them is.
    decided: Notify,
    open_links: Mutex<OpenLinks>,
    open_radio: Box<OpenRadio>,
}

/// What a dial takes from this node's listener: where it listens, and as whom.
#[derive(Clone)]
pub(crate) struct Listening {
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
            links: Mutex::new(Links::new(id)),
            stop_dialling: CancellationToken::new(),
            unlinked: Notify::new(),
            released: Notify::new(),
            adapters: Mutex::default(),
            listening: Mutex::default(),
            history: Mutex::default(),
            strangers: Mutex::default(),
            greeted: Mutex::default(),
            decided: Notify::new(),
            open_links: Mutex::default(),
            open_radio,
        })
    }

    pub(crate) fn links(&self) -> MutexGuard<'_, Links> {
        self.links.lock()
    }

    pub(crate) fn on_link_open(&self, number: LinkNumber, peer: &str, link: &Arc<LinkBle>) {
        self.history.lock().on_linked(peer);
        self.open_links.lock().add(number, link);
    }

    pub(crate) fn on_link_ended(&self, number: LinkNumber, peer: &str, reason: &str) {
        self.history
            .lock()
            .on_ended(peer, reason, Instant::now().into_std());
        self.on_link_closed(number);
    }

    pub(crate) fn on_failed_dial(&self, target: &str, reason: &str) {
        let mut history = self.history.lock();
        history.on_failed_dial(target, reason, Instant::now().into_std());
    }

    /// A device has opened a channel; dropping what is returned tells that it is linked, or refused.
    pub(crate) fn on_greeting(self: &Arc<Self>, device: DeviceAddress) -> Greeting {
        self.greeted.lock().push(device);
        Greeting {
            node: Arc::clone(self),
            device,
        }
    }

    /// Waits until that device is not in the middle of opening a link. A channel asked for meanwhile may cross its own:
    /// see [`BleError::Astray`](crate::BleError::Astray).
    pub(crate) async fn greetings_with(&self, device: DeviceAddress) {
        loop {
            let decided = self.decided.notified();
            if !self.greeted.lock().contains(&device) {
                return;
            }
            decided.await;
        }
    }

    pub(crate) fn on_no_proof(&self, device: DeviceAddress) {
        let now = Instant::now().into_std();
        self.strangers.lock().on_no_proof(device, now);
    }

    pub(crate) fn is_stranger(&self, device: DeviceAddress) -> bool {
        let now = Instant::now().into_std();
        self.strangers.lock().has(device, now)
    }

    pub(crate) fn status(&self) -> NodeStatus {
        let links = self.open_links.lock().all();
        let adapters: Vec<_> = self.adapters.lock().values().cloned().collect();
        NodeStatus {
            name: self.name(),
            links: links.iter().map(|link| link.status()).collect(),
            peers: self.history.lock().status(Instant::now().into_std()),
            heard: (adapters.iter().flat_map(|adapter| adapter.scanner.heard())).collect(),
        }
    }

    pub(crate) fn on_link_closed(&self, link: LinkNumber) {
        self.links().on_closed(link);
        self.open_links.lock().remove(link);
        // What was heard before says nothing now: the peer may have gone for good, and a connect would wait for it.
        for adapter in self.adapters.lock().values() {
            adapter.scanner.forget();
        }
        self.unlinked.notify_waiters();
    }

    pub(crate) fn on_link_released(&self, link: LinkNumber) {
        let now = Instant::now().into_std();
        self.links().on_released(link, now);
        self.released.notify_waiters();
    }

    /// Waits until Zenoh may have that link: see `pause`.
    pub(crate) async fn pause(&self, link: LinkNumber) {
        let pause = async {
            loop {
                let released = self.released.notified();
                let pause = self.links().on_ready(link, Instant::now().into_std());
                match pause {
                    Pause::Over => return,
                    Pause::Until(end) => tokio::time::sleep_until(end.into()).await,
                    Pause::UntilReleased => released.await,
                }
            }
        };
        if tokio::time::timeout(LONGEST_PAUSE, pause).await.is_err() {
            tracing::debug!("ble: links end so fast that Zenoh may miss a new one");
            self.links().on_given(link);
        }
    }

    /// The adapter of that name; left out, the one this node listens on, else the system's default.
    pub(crate) fn adapter(&self, name: Option<&str>) -> Result<Arc<Adapter>, RadioError> {
        let listened = self.listening.lock().first().map(|l| l.adapter.clone());
        let name = name.map(str::to_owned).or(listened);
        let mut adapters = self.adapters.lock();
        let key = name.clone().unwrap_or_default();
        if let Some(adapter) = adapters.get(&key) {
            return Ok(Arc::clone(adapter));
        }
        let adapter = Adapter::new((self.open_radio)(name.as_deref())?);
        adapters.insert(key, Arc::clone(&adapter));
        Ok(adapter)
    }

    pub(crate) fn on_listening(&self, listening: Listening) {
        self.listening.lock().push(listening);
    }

    pub(crate) fn on_listening_ended(&self, adapter: &str) {
        self.listening.lock().retain(|l| l.adapter != adapter);
    }

    /// The name this node goes by when it dials: its listener's; empty for one that does not listen.
    pub(crate) fn name(&self) -> String {
        self.listening
            .lock()
            .first()
            .map_or_else(String::new, |l| l.name.clone())
    }

    /// What whoever is dialled must have, if the locator says nothing of it.
    pub(crate) fn secret(&self) -> Option<Secret> {
        (self.listening.lock().first()).and_then(|l| l.secret.clone())
    }

    /// What distinguishes this run's advertisement from an earlier one's.
    pub(crate) fn incarnation(&self) -> u16 {
        (self.id.0 & 0xffff) as u16
    }
}

/// A device is in the middle of opening a link.
pub(crate) struct Greeting {
    node: Arc<Node>,
    device: DeviceAddress,
}

impl Drop for Greeting {
    fn drop(&mut self) {
        let mut greeted = self.node.greeted.lock();
        if let Some(at) = greeted.iter().position(|device| *device == self.device) {
            greeted.swap_remove(at);
        }
        drop(greeted);
        self.node.decided.notify_waiters();
    }
}
