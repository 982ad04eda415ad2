//! Keeps what all `any` links of one Zenoh runtime share: its Bluetooth node, its TCP listener and its links.
use std::{
    collections::{HashMap, VecDeque},
    future::Future,
    net::SocketAddr,
    sync::{Arc, Weak},
    time::Duration,
};

use parking_lot::Mutex;
use tokio::{
    net::{TcpListener, TcpStream},
    runtime::Handle,
};
use tokio_util::{sync::CancellationToken, task::AbortOnDropHandle};
use zenoh_link_ble::{
    path::{AcceptPaths, BlePath, DialledPath},
    protocol::hello::{NodeId, PathOf, Refusal},
    BleError, LinkManagerUnicastBle,
};
use zenoh_link_commons::{LinkUnicast, LinkUnicastTrait, NewLinkChannelSender};
use zenoh_protocol::core::EndPoint;

use crate::{
    connect,
    error::AnyError,
    link::LinkAny,
    locator::ConnectLocator,
    multipath::Options,
    networks, offer,
    proof::{Proof, Role, Tag, KEY_LABEL, TAG_LABEL},
    run,
    shared::Shared,
    wifi,
};

/// Number of accepted connections that may be unproven at the same time.
const MAX_UNPROVEN: usize = 8;
/// How long the side that has accepted the link leaves dialling to the other one.
const ACCEPTOR_DELAY: Duration = Duration::from_millis(1500);
/// The shortest and the longest time between attempts to open a path.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30));

/// The shared parts of all links of one runtime.
pub(crate) struct Hub {
    pub(crate) ble: LinkManagerUnicastBle,
    new_links: NewLinkChannelSender,
    runtime: Handle,
    links: Mutex<HashMap<u64, Weak<Shared>>>,
    tcp: Mutex<Option<Tcp>>,
}

/// The TCP listener.
struct Tcp {
    port: u16,
    interfaces: Option<Vec<String>>,
    /// Whether connections run through the simulated Wi-Fi.
    is_simulated: bool,
    _accepting: AbortOnDropHandle<()>,
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
        });
        hubs.push(Arc::downgrade(&hub));
        hub
    }

    /// Returns all links of this process.
    pub(crate) fn all_links() -> Vec<Arc<Shared>> {
        let hubs: Vec<_> = HUBS.lock().iter().filter_map(Weak::upgrade).collect();
        hubs.iter().flat_map(|hub| hub.links()).collect()
    }

    fn links(&self) -> Vec<Arc<Shared>> {
        let mut links = self.links.lock();
        links.retain(|_, link| link.upgrade().is_some_and(|link| !link.has_ended()));
        links.values().filter_map(Weak::upgrade).collect()
    }

    fn link_with(&self, peer: &str) -> Option<Arc<Shared>> {
        self.links().into_iter().find(|link| link.peer == peer)
    }

    /// Opens a link with a peer. One that knows no such links gets a `ble` link.
    pub(crate) async fn open(
        self: &Arc<Self>,
        locator: ConnectLocator,
    ) -> Result<LinkUnicast, AnyError> {
        if self.link_with(&locator.peer).is_some() {
            return Err(AnyError::AlreadyLinked(locator.peer));
        }
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
        let shared = self.add_link(path_of.link, &path, Role::Opener);
        let link = self.start(&shared, path)?;
        self.spawn(Arc::clone(self).keep_bluetooth(Arc::clone(&shared), endpoint));
        let link: Arc<dyn LinkUnicastTrait> = link;
        Ok(LinkUnicast::from(link))
    }

    /// Creates the state of a link that begins with a Bluetooth path.
    fn add_link(&self, id: u64, path: &BlePath, role: Role) -> Arc<Shared> {
        let keys = path
            .exported_key(KEY_LABEL)
            .zip(path.exported_key(TAG_LABEL));
        let proof = keys.map(|(key, tag)| Proof::new(key, tag, role));
        let node = path.agreed().map_or(NodeId(0), |agreed| agreed.node);
        let shared = Shared::new(
            id,
            path.peer().to_owned(),
            node,
            role,
            proof,
            Options::default(),
        );
        self.links.lock().insert(id, Arc::downgrade(&shared));
        shared
    }

    /// Starts the tasks of a new link, and returns it for Zenoh.
    fn start(
        self: &Arc<Self>,
        shared: &Arc<Shared>,
        path: BlePath,
    ) -> Result<Arc<LinkAny>, AnyError> {
        let link = LinkAny::new(Arc::clone(shared), path.adapter())?;
        shared.offer(self.offer());
        self.run_ble(Arc::clone(shared), path, true);
        if shared.proof.is_some() {
            self.spawn(Arc::clone(self).keep_network(Arc::clone(shared)));
        }
        Ok(link)
    }

    fn run_ble(&self, shared: Arc<Shared>, path: BlePath, is_proven: bool) {
        self.spawn(run::run_ble(shared, path, is_proven));
    }

    /// Returns the addresses to offer.
    fn offer(&self) -> Vec<u8> {
        match &*self.tcp.lock() {
            Some(tcp) => {
                let addresses = networks::own_addresses(tcp.interfaces.as_deref());
                offer::encode(tcp.port, &addresses)
            }
            None => offer::encode(0, &[]),
        }
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
                    shared.unless_ended(tokio::time::sleep(retry)).await;
                    retry = (retry * 2).min(RETRY.1);
                }
            }
        }
    }

    /// Opens a network path to the addresses that the peer has offered whenever the link needs one, and offers this side's
    /// addresses whenever they have changed.
    async fn keep_network(self: Arc<Self>, shared: Arc<Shared>) {
        let mut offered = shared.offered();
        let mut retry = RETRY.0;
        if shared.role == Role::Acceptor {
            let delay = tokio::time::sleep(ACCEPTOR_DELAY);
            shared.unless_ended(delay).await;
        }
        while !shared.has_ended() {
            let changed = shared.paths_changed.notified();
            shared.offer(self.offer());
            let addresses = self.reachable(&offered.borrow_and_update());
            let needs_network = shared.needs_network();
            if needs_network {
                if let Some(connection) = self.connect(&shared, &addresses).await {
                    // The peer may have connected meanwhile.
                    if shared.role == Role::Opener || shared.needs_network() {
                        self.spawn(run::run_tcp(Arc::clone(&shared), connection));
                    }
                }
            } else {
                retry = RETRY.0;
                if shared.role == Role::Opener {
                    shared.end_spare_paths();
                }
            }
            let waits = async {
                let new_offer = async { drop(offered.changed().await) };
                // Without a network path, this side tries again; with one, it looks for other addresses now and then.
                let pause = if needs_network { retry } else { RETRY.1 };
                tokio::select! {
                    () = new_offer => {}
                    () = changed, if !needs_network => {}
                    () = tokio::time::sleep(pause) => {}
                }
            };
            shared.unless_ended(waits).await;
            if needs_network {
                retry = (retry * 2).min(RETRY.1);
            }
        }
    }

    fn reachable(&self, offered: &[SocketAddr]) -> Vec<SocketAddr> {
        let tcp = self.tcp.lock();
        let has_network = |tcp: &Tcp| !tcp.is_simulated || wifi::socket_path().exists();
        if !tcp.as_ref().is_some_and(has_network) {
            return Vec::new();
        }
        let interfaces = tcp.as_ref().and_then(|tcp| tcp.interfaces.as_deref());
        networks::reachable(offered, interfaces)
    }

    async fn connect(&self, shared: &Shared, addresses: &[SocketAddr]) -> Option<run::Connection> {
        let is_simulated = self.tcp.lock().as_ref().is_some_and(|tcp| tcp.is_simulated);
        for address in addresses {
            let connected = tokio::select! {
                connected = connect::connect(shared, *address, is_simulated) => connected,
                () = shared.ended() => return None,
            };
            match connected {
                Ok(connection) => return Some(connection),
                Err(error) => {
                    tracing::debug!("any: no path to {} at {address}: {error}", shared.peer);
                }
            }
        }
        None
    }

    /// Accepts Bluetooth paths of peers. A node that listens only with `ble/` accepts none: its peers get `ble` links.
    pub(crate) fn accept_bluetooth(self: &Arc<Self>) {
        let acceptor: Arc<dyn AcceptPaths> = Arc::<Self>::clone(self);
        self.ble.accept_paths(&acceptor);
    }

    /// Accepts further paths on a TCP port, or on one that the system chooses. A simulated robot accepts them on the loopback
    /// interface.
    pub(crate) fn listen(
        self: &Arc<Self>,
        port: Option<u16>,
        interfaces: Option<Vec<String>>,
        is_simulated: bool,
    ) -> Result<(), AnyError> {
        let interfaces = match is_simulated {
            true => Some(vec!["lo".to_owned()]),
            false => interfaces,
        };
        let port = port.unwrap_or(0);
        let bound = {
            let _runtime = self.runtime.enter();
            bind(port, is_simulated)
        };
        let with_port = bound.and_then(|listener| {
            let port = listener.local_addr()?.port();
            Ok((listener, port))
        });
        let (listener, port) = with_port.map_err(|error| AnyError::Listen { port, error })?;
        let accepting = self.runtime.spawn(Arc::clone(self).accept(listener));
        *self.tcp.lock() = Some(Tcp {
            port,
            interfaces,
            is_simulated,
            _accepting: AbortOnDropHandle::new(accepting),
        });
        Ok(())
    }

    async fn accept(self: Arc<Self>, listener: TcpListener) {
        let mut unproven: VecDeque<CancellationToken> = VecDeque::new();
        loop {
            let (stream, address) = match listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!("any: cannot accept a connection: {error}");
                    tokio::time::sleep(RETRY.0).await;
                    continue;
                }
            };
            // A proof takes milliseconds, so unauthenticated peers that send nothing cannot keep a robot out: the oldest
            // connection gives way.
            unproven.retain(|one| !one.is_cancelled());
            if unproven.len() >= MAX_UNPROVEN {
                if let Some(oldest) = unproven.pop_front() {
                    oldest.cancel();
                }
            }
            let ended = CancellationToken::new();
            unproven.push_back(ended.clone());
            let hub = Arc::clone(&self);
            self.spawn(async move {
                let proven = ended.run_until_cancelled(hub.prove(stream)).await;
                ended.cancel();
                match proven {
                    // Both have dialled at the same time, and the opener's connection takes precedence.
                    Some(Ok((shared, _)))
                        if shared.role == Role::Opener && !shared.needs_network() => {}
                    Some(Ok((shared, connection))) => run::run_tcp(shared, connection).await,
                    Some(Err(error)) => {
                        tracing::debug!("any: closed a connection from {address}: {error}");
                    }
                    None => tracing::debug!(
                        "any: closed a connection from {address}, because there are newer ones"
                    ),
                }
            });
        }
    }

    async fn prove(&self, stream: TcpStream) -> std::io::Result<(Arc<Shared>, run::Connection)> {
        let find = |tag: Tag| {
            let mut links = self.links().into_iter();
            links.find(|link| link.proof.as_ref().is_some_and(|proof| proof.tag == tag))
        };
        connect::accept(stream, find).await
    }

    /// Returns whether this side accepts further paths.
    pub(crate) fn is_listening(&self) -> bool {
        self.tcp.lock().is_some()
    }

    /// Closes the TCP listener.
    pub(crate) fn stop_listening(&self) {
        *self.tcp.lock() = None;
    }
}

impl AcceptPaths for Hub {
    fn refusal(&self, peer: &str, node: NodeId, path: Option<PathOf>) -> Option<Refusal> {
        let links = self.links();
        if let Some(path) = path.filter(|path| path.joins) {
            let has_link = links.iter().any(|link| link.id == path.link);
            return (!has_link).then_some(Refusal::NoSuchLink);
        }
        // A peer that was restarted is another node: its link has ended.
        let is_linked = |link: &Arc<Shared>| link.peer == peer && link.node == node;
        links
            .iter()
            .any(is_linked)
            .then_some(Refusal::AlreadyLinked)
    }

    fn on_path(self: Arc<Self>, path: BlePath) {
        let Some(agreed) = path.agreed() else {
            return;
        };
        let PathOf { link: id, joins } = agreed.of;
        let existing = self.links().into_iter().find(|link| link.id == id);
        match existing {
            Some(shared) if joins && shared.peer == path.peer() => {
                self.run_ble(shared, path, false);
            }
            // Its tasks end, and the peer opens a new link.
            _ if joins => {}
            _ => {
                if let Some(old) = self.link_with(path.peer()) {
                    old.fail(AnyError::Replaced(old.peer.clone()));
                }
                let shared = self.add_link(id, &path, Role::Acceptor);
                let link: Arc<dyn LinkUnicastTrait> = match self.start(&shared, path) {
                    Ok(link) => link,
                    Err(error) => return tracing::warn!("any: {error}"),
                };
                let new_links = self.new_links.clone();
                self.spawn(async move {
                    let _ = new_links.send_async(LinkUnicast::from(link)).await;
                });
            }
        }
    }
}

/// Opens a listener for IPv4 and IPv6 on all addresses, or on the loopback interface. A connection is used only after it has
/// proved its link.
fn bind(port: u16, is_local: bool) -> std::io::Result<TcpListener> {
    use socket2::{Domain, Socket, Type};
    let listen = |domain: Domain, address: SocketAddr| {
        let socket = Socket::new(domain, Type::STREAM, None)?;
        socket.set_reuse_address(true)?;
        socket.set_nonblocking(true)?;
        if domain == Domain::IPV6 {
            socket.set_only_v6(false)?;
        }
        socket.bind(&address.into())?;
        socket.listen(MAX_UNPROVEN as i32)?;
        TcpListener::from_std(socket.into())
    };
    let any_v6 = SocketAddr::from((std::net::Ipv6Addr::UNSPECIFIED, port));
    let any_v4 = SocketAddr::from((std::net::Ipv4Addr::UNSPECIFIED, port));
    if is_local {
        let local = SocketAddr::from((std::net::Ipv4Addr::LOCALHOST, port));
        return listen(Domain::IPV4, local);
    }
    // A kernel without IPv6 has only the second.
    listen(Domain::IPV6, any_v6).or_else(|_| listen(Domain::IPV4, any_v4))
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
