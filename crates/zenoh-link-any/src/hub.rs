//! Keeps what all `any` links of one Zenoh runtime share: its Bluetooth node, its TCP listener and its links.
mod meet;
mod tcp;

use std::{
    collections::HashMap,
    future::Future,
    net::SocketAddr,
    sync::{atomic::AtomicUsize, Arc, Weak},
    time::Duration,
};

use link_lanes::{
    hello::{NodeId, PathOf, Refusal},
    key_agreement::Exporter,
};
use parking_lot::Mutex;
use tokio::runtime::Handle;
use zenoh_link_ble::{
    path::{AcceptPaths, BlePath, DialledPath},
    BleError, LinkManagerUnicastBle,
};
use zenoh_link_commons::{LinkUnicast, LinkUnicastTrait, NewLinkChannelSender};
use zenoh_protocol::core::EndPoint;

use self::tcp::Tcp;
use crate::{
    error::AnyError,
    link::LinkAny,
    locator::ConnectLocator,
    multipath::Options,
    proof::{Proof, Role, KEY_LABEL, TAG_LABEL},
    run,
    shared::Shared,
};

/// How long the side that has accepted the link leaves dialling to the other one.
const ACCEPTOR_DELAY: Duration = Duration::from_millis(1500);
/// The shortest and the longest time between attempts to open a path.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30));

/// The largest number of links of one runtime that accept further ones. Each keeps what is in flight, at most
/// [`MAX_IN_FLIGHT_BYTES`](crate::path::MAX_IN_FLIGHT_BYTES) for each path: 8 MB for all network paths.
const MAX_LINKS: usize = 32;

/// The shared parts of all links of one runtime.
pub(crate) struct Hub {
    pub(crate) ble: LinkManagerUnicastBle,
    new_links: NewLinkChannelSender,
    runtime: Handle,
    links: Mutex<HashMap<u64, Weak<Shared>>>,
    tcp: Mutex<Option<Tcp>>,
    /// Number of links that this side is opening on TCP, and that the peer has not answered yet.
    meetings: AtomicUsize,
    /// The peer that has answered at each address of a locator.
    met: Mutex<HashMap<String, String>>,
}

static HUBS: Mutex<Vec<Weak<Hub>>> = Mutex::new(Vec::new());

impl Hub {
    /// Returns the hub of the runtime that takes accepted links from this channel.
    pub(crate) fn of(new_links: NewLinkChannelSender) -> Arc<Self> {
        let mut hubs = HUBS.lock();
        hubs.retain(|hub| hub.strong_count() > 0);
        let is_of_runtime = |hub: &Arc<Self>| hub.new_links.same_channel(&new_links);
        let existing = hubs.iter().filter_map(Weak::upgrade).find(is_of_runtime);
        if let Some(hub) = existing {
            return hub;
        }
        let runtime: &Handle = &zenoh_runtime::ZRuntime::Acceptor;
        let hub = Arc::new(Self {
            ble: LinkManagerUnicastBle::new(new_links.clone()),
            new_links,
            runtime: runtime.clone(),
            links: Mutex::default(),
            tcp: Mutex::new(None),
            meetings: AtomicUsize::new(0),
            met: Mutex::default(),
        });
        hubs.push(Arc::downgrade(&hub));
        hub
    }

    /// Returns all hubs of this process.
    pub(crate) fn all() -> Vec<Arc<Self>> {
        HUBS.lock().iter().filter_map(Weak::upgrade).collect()
    }

    /// Returns the addresses at which a peer has answered, as in the locators.
    pub(crate) fn addresses_of(&self, peer: &str) -> Vec<String> {
        let met = self.met.lock();
        let of_peer = met.iter().filter(|(_, met)| *met == peer);
        of_peer.map(|(address, _)| address.clone()).collect()
    }

    pub(crate) fn links(&self) -> Vec<Arc<Shared>> {
        let mut links = self.links.lock();
        links.retain(|_, link| link.upgrade().is_some_and(|link| !link.has_ended()));
        links.values().filter_map(Weak::upgrade).collect()
    }

    fn link_with(&self, peer: &str) -> Option<Arc<Shared>> {
        self.links().into_iter().find(|link| link.peer == peer)
    }

    /// Returns whether there are too many links to accept one with a peer. A new link replaces an old one with the same peer.
    fn is_full_for(&self, peer: &str) -> bool {
        let links = self.links();
        links.len() >= MAX_LINKS && links.iter().all(|link| link.peer != peer)
    }

    /// Returns the link with a peer that the peer has, too. A peer that was restarted is another node, and one that has lost the link
    /// sends nothing on it: a new link then replaces this one.
    fn existing(&self, peer: &str, node: NodeId) -> Option<Arc<Shared>> {
        self.link_with(peer)
            .filter(|link| link.node == node && link.is_shared())
    }

    /// Opens a link with a peer: at its address if one is given, and otherwise or if that fails over Bluetooth.
    pub(crate) async fn open(
        self: &Arc<Self>,
        locator: ConnectLocator,
    ) -> Result<LinkUnicast, AnyError> {
        if let Some(peer) = locator
            .peer
            .as_ref()
            .filter(|peer| self.link_with(peer).is_some())
        {
            return Err(AnyError::AlreadyLinked(peer.clone()));
        }
        let Some(address) = &locator.address else {
            return self.open_on_bluetooth(&locator).await;
        };
        match self.meet(&locator, address).await {
            Ok(link) => Ok(link),
            Err(error @ AnyError::AlreadyLinked(_)) => Err(error),
            Err(error) if locator.peer.is_none() => Err(error),
            Err(error) => match self.open_on_bluetooth(&locator).await {
                Err(AnyError::Ble(ble)) => {
                    let network = Box::new(error);
                    Err(AnyError::Nowhere { network, ble })
                }
                opened => opened,
            },
        }
    }

    /// Opens a link over Bluetooth. A peer that knows no `any` links gets a `ble` link.
    async fn open_on_bluetooth(
        self: &Arc<Self>,
        locator: &ConnectLocator,
    ) -> Result<LinkUnicast, AnyError> {
        let path_of = PathOf {
            link: random_number(),
            joins: false,
        };
        let path = match self.ble.dial_path(locator.ble.clone(), path_of).await? {
            DialledPath::Path(path) => path,
            DialledPath::Link(link) => return Ok(link),
        };
        if self.link_with(path.peer()).is_some() {
            return Err(AnyError::AlreadyLinked(path.peer().to_owned()));
        }
        let endpoint = locator.to(path.peer())?;
        let shared = self.add_link_of(&path, path_of.link, Role::Opener);
        let link = self.start_on_bluetooth(&shared, path)?;
        self.spawn(Arc::clone(self).keep_bluetooth(Arc::clone(&shared), endpoint));
        let link: Arc<dyn LinkUnicastTrait> = link;
        Ok(LinkUnicast::from(link))
    }

    /// Creates the state of a link that begins with a Bluetooth path.
    fn add_link_of(&self, path: &BlePath, id: u64, role: Role) -> Arc<Shared> {
        let agreed = path.agreed();
        let node = agreed.map_or(NodeId(0), |agreed| agreed.node);
        let is_compressed = agreed.is_some_and(|agreed| agreed.accepts_compressed);
        let (peer, keys) = (path.peer().to_owned(), path.exporter());
        self.add_link(id, peer, node, role, keys, is_compressed)
    }

    /// Creates the state of a link. Without keys for its further paths, it has none. `is_compressed`: the peer accepts compressed
    /// batches.
    fn add_link(
        &self,
        id: u64,
        peer: String,
        node: NodeId,
        role: Role,
        keys: Option<&Exporter>,
        is_compressed: bool,
    ) -> Arc<Shared> {
        let proof = keys.map(|keys| Proof::new(keys.key(KEY_LABEL), keys.key(TAG_LABEL), role));
        let options = Options::default();
        let shared = Shared::new(id, peer, node, role, proof, is_compressed, options);
        self.links.lock().insert(id, Arc::downgrade(&shared));
        shared
    }

    fn start_on_bluetooth(
        self: &Arc<Self>,
        shared: &Arc<Shared>,
        path: BlePath,
    ) -> Result<Arc<LinkAny>, AnyError> {
        let adapter = path.adapter().to_owned();
        let carrying = run::run_ble(Arc::clone(shared), path, true);
        self.start(shared, &adapter, None, carrying)
    }

    /// Starts the tasks of a new link, `first_path` among them, and returns the link for Zenoh. `known` is an address of the peer
    /// that it need not offer.
    fn start(
        self: &Arc<Self>,
        shared: &Arc<Shared>,
        source: &str,
        known: Option<SocketAddr>,
        first_path: impl Future<Output = ()> + Send + 'static,
    ) -> Result<Arc<LinkAny>, AnyError> {
        let link = LinkAny::new(Arc::clone(shared), source)?;
        shared.offer(self.offer());
        self.spawn(first_path);
        if shared.proof.is_some() {
            self.spawn(Arc::clone(self).keep_network(Arc::clone(shared), known));
        }
        Ok(link)
    }

    /// Ends the earlier links with a peer that has opened a new one.
    fn replace_by(&self, new: &Shared) {
        let links = self.links().into_iter();
        for old in links.filter(|link| link.peer == new.peer && link.id != new.id) {
            old.fail(AnyError::Replaced(old.peer.clone()));
        }
    }

    /// Gives an accepted link to Zenoh.
    async fn hand_over(&self, link: Arc<LinkAny>) {
        let link: Arc<dyn LinkUnicastTrait> = link;
        // Zenoh takes no more links while it shuts down.
        let _ = self.new_links.send_async(LinkUnicast::from(link)).await;
    }

    fn spawn(&self, task: impl Future<Output = ()> + Send + 'static) {
        self.runtime.spawn(task);
    }

    /// Opens the Bluetooth path of a link again whenever it is lost.
    async fn keep_bluetooth(self: Arc<Self>, shared: Arc<Shared>, endpoint: EndPoint) {
        let mut retry = RETRY.0;
        while !shared.has_ended() {
            let changed = shared.paths_changed.notified();
            if shared.has_bluetooth() {
                retry = RETRY.0;
                shared.unless_ended(changed).await;
                continue;
            }
            let path_of = PathOf {
                link: shared.id,
                joins: true,
            };
            let dialled = tokio::select! {
                dialled = self.ble.dial_path(endpoint.clone(), path_of) => dialled,
                () = shared.ended() => return,
            };
            match dialled {
                Ok(DialledPath::Path(path)) => {
                    run::run_ble(Arc::clone(&shared), path, false).await;
                }
                Ok(DialledPath::Link(_))
                | Err(BleError::Refused {
                    refusal: Refusal::NoSuchLink,
                    ..
                }) => return shared.fail(AnyError::Replaced(shared.peer.clone())),
                Err(error) => {
                    tracing::debug!("any: no Bluetooth path to {}: {error}", shared.peer);
                    if let BleError::Refused {
                        refusal: Refusal::Full,
                        ..
                    } = error
                    {
                        retry = RETRY.1;
                    }
                    shared.unless_ended(tokio::time::sleep(retry)).await;
                    retry = (retry * 2).min(RETRY.1);
                }
            }
        }
    }

    /// Opens a network path to the addresses that the peer has offered, or to the `known` one, whenever the link needs one, and
    /// offers this side's addresses whenever they have changed.
    async fn keep_network(self: Arc<Self>, shared: Arc<Shared>, known: Option<SocketAddr>) {
        let mut offered = shared.offered();
        let mut retry = RETRY.0;
        if shared.role == Role::Acceptor {
            let delay = tokio::time::sleep(ACCEPTOR_DELAY);
            shared.unless_ended(delay).await;
        }
        while !shared.has_ended() {
            let changed = shared.paths_changed.notified();
            let networks_changed = shared.networks_changed.notified();
            shared.offer(self.offer());
            let mut addresses = self.reachable(&offered.borrow_and_update());
            addresses.extend(known.filter(|known| !addresses.contains(known)));
            let needs_network = shared.needs_network();
            if needs_network {
                if let Some(connection) = self.connect(&shared, &addresses).await {
                    // The peer may have connected meanwhile.
                    if shared.role == Role::Opener || shared.needs_network() {
                        self.spawn(run::run_tcp(Arc::clone(&shared), connection, false));
                    }
                }
            } else {
                retry = RETRY.0;
                if shared.role == Role::Opener {
                    shared.end_spare_paths();
                }
            }
            // Without a network path, this side tries again; with one, it looks for other addresses now and then.
            let pause = if needs_network { retry } else { RETRY.1 };
            retry = (retry * 2).min(RETRY.1);
            let waits = async {
                tokio::select! {
                    _ = offered.changed() => {}
                    () = changed, if !needs_network => {}
                    () = networks_changed => retry = RETRY.0,
                    () = tokio::time::sleep(pause) => {}
                }
            };
            shared.unless_ended(waits).await;
        }
    }

    /// Accepts Bluetooth paths of peers. A node that listens only with `ble/` accepts none: its peers get `ble` links.
    pub(crate) fn accept_bluetooth(self: &Arc<Self>) {
        let acceptor: Arc<dyn AcceptPaths> = Arc::<Self>::clone(self);
        self.ble.accept_paths(&acceptor);
    }
}

impl AcceptPaths for Hub {
    fn refusal(
        &self,
        peer: &str,
        node: NodeId,
        path: Option<PathOf>,
        free_places: usize,
    ) -> Option<Refusal> {
        if let Some(path) = path.filter(|path| path.joins) {
            let links = self.links();
            let Some(link) = links.iter().find(|link| link.id == path.link) else {
                return Some(Refusal::NoSuchLink);
            };
            // The last place is for a robot that cannot be reached otherwise.
            let is_last = free_places <= 1 && link.has_live_network();
            return is_last.then_some(Refusal::Full);
        }
        if self.existing(peer, node).is_some() {
            return Some(Refusal::AlreadyLinked);
        }
        self.is_full_for(peer).then_some(Refusal::Full)
    }

    fn make_room(&self) {
        let links = self.links().into_iter();
        let standby = links.filter(|link| {
            link.role == Role::Acceptor && link.has_bluetooth() && link.has_live_network()
        });
        if let Some(newest) = standby.max_by_key(|link| link.since) {
            newest.end_bluetooth();
        }
    }

    fn on_path(self: Arc<Self>, path: BlePath) {
        let Some(agreed) = path.agreed() else {
            return;
        };
        let PathOf { link: id, joins } = agreed.of;
        let existing = self.links().into_iter().find(|link| link.id == id);
        match existing {
            Some(shared) if joins && shared.peer == path.peer() => {
                self.spawn(run::run_ble(shared, path, false));
            }
            // Its tasks end, and the peer opens a new link.
            _ if joins => {}
            _ => {
                let shared = self.add_link_of(&path, id, Role::Acceptor);
                self.replace_by(&shared);
                let link = match self.start_on_bluetooth(&shared, path) {
                    Ok(link) => link,
                    Err(error) => return tracing::warn!("any: {error}"),
                };
                let hub = Arc::clone(&self);
                self.spawn(async move { hub.hand_over(link).await });
            }
        }
    }
}

fn random_number() -> u64 {
    let mut bytes = [0; 8];
    if getrandom::fill(&mut bytes).is_err() {
        // The number need only differ from those of earlier links.
        let time = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        bytes = time.map_or([1; 8], |time| (time.as_nanos() as u64).to_le_bytes());
    }
    u64::from_le_bytes(bytes)
}
