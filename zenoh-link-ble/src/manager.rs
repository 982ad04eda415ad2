//! Implements Zenoh's link manager of the `ble` protocol, which dials links and manages listeners.
use std::{collections::HashMap, sync::Arc};

use async_trait::async_trait;
use link_lanes::{
    hello::{NodeId, PathOf},
    secret::Secret,
};
use tokio::{runtime::Handle, sync::Mutex};
use tokio_util::task::AbortOnDropHandle;
use zenoh_link_ble_radio::{Radio, RadioError};
use zenoh_link_commons::{
    LinkManagerUnicastTrait, LinkUnicast, LinkUnicastTrait, NewLinkChannelSender,
};
use zenoh_protocol::core::{EndPoint, Locator};
use zenoh_result::ZResult;

use crate::{
    dialer::dial,
    error::{describe, into_zenoh, BleError, DialStep},
    link::{
        node::Node,
        path::{AcceptPaths, BlePath, DialledPath},
        table::LinkCounts,
        LinkBle,
    },
    listener::Listener,
    locator::{is_simulated, ConnectLocator, ListenLocator, Target, BLE_LOCATOR_PREFIX},
    status,
};

/// The identity of a node for its peers.
#[derive(Clone, Debug)]
pub struct Identity {
    /// The Zenoh runtime.
    pub node: NodeId,
    /// The name of the node's listener, or an empty one.
    pub name: String,
    /// The secret of the node's listener.
    pub secret: Option<Secret>,
}

/// Dials and accepts `ble` links for one Zenoh runtime.
pub struct LinkManagerUnicastBle {
    node: Arc<Node>,
    runtime: Handle,
    /// The listeners by the name of their adapter.
    listeners: Mutex<HashMap<String, RunningListener>>,
}

struct RunningListener {
    endpoint: EndPoint,
    /// The locator that a peer can dial: it contains the name, and not this computer's adapter.
    locator: Locator,
    // Dropping the task ends the listener.
    _serving: AbortOnDropHandle<()>,
    _watching: AbortOnDropHandle<()>,
}

impl LinkManagerUnicastBle {
    /// Creates a manager for this computer's radios: BlueZ's adapters, and simulated ones for names that begin with `sim`.
    /// Accepted links are sent on `links`. Managers with the same channel belong to one Zenoh runtime and form one node.
    pub fn new(links: NewLinkChannelSender) -> Self {
        let runtime: &Handle = &zenoh_runtime::ZRuntime::Acceptor;
        let is_of_runtime = |node: &Node| node.new_links.same_channel(&links);
        let make = || Node::new(random_node_id(), links.clone(), Box::new(open_radio));
        Self {
            node: status::find_or_add(is_of_runtime, make),
            runtime: runtime.clone(),
            listeners: Mutex::default(),
        }
    }

    /// Creates a manager for the radios that `open_radio` returns, with its tasks on `runtime`: for tests. `node` must be
    /// unique. The node's incarnation and its connect timeouts are derived from it, so that tests are reproducible.
    pub fn with_radios(
        links: NewLinkChannelSender,
        runtime: Handle,
        node: NodeId,
        open_radio: impl Fn(Option<&str>) -> Result<Arc<dyn Radio>, RadioError> + Send + Sync + 'static,
    ) -> Self {
        let node = Node::new(node, links, Box::new(open_radio));
        Self {
            node: status::find_or_add(|_| false, || node),
            runtime,
            listeners: Mutex::default(),
        }
    }

    /// Returns the current number of links and dials.
    pub fn link_counts(&self) -> LinkCounts {
        self.node.link_table().link_counts()
    }

    /// Sets the part of the program that takes channels which become paths of other links. Without it, or after it was
    /// dropped, such channels carry Zenoh's batches themselves.
    pub fn accept_paths(&self, acceptor: &Arc<dyn AcceptPaths>) {
        self.node.set_path_acceptor(acceptor);
    }

    /// Dials a peer for a path of another link. A peer that knows no such links gets a `ble` link.
    ///
    /// # Errors
    /// Fails as [`LinkManagerUnicastTrait::new_link`] does.
    pub async fn dial_path(
        &self,
        endpoint: EndPoint,
        path: PathOf,
    ) -> Result<DialledPath, BleError> {
        let link = self.dial(endpoint, Some(path)).await?;
        if link.path().is_some() {
            return Ok(DialledPath::Path(BlePath::new(link)));
        }
        let link: Arc<dyn LinkUnicastTrait> = link;
        Ok(DialledPath::Link(LinkUnicast::from(link)))
    }

    /// Returns the identity of this node, which paths over other media share.
    pub fn identity(&self) -> Identity {
        Identity {
            node: self.node.id,
            name: self.node.name(),
            secret: self.node.secret(),
        }
    }

    /// Dials a peer. With `path`, the channel becomes a path of that link if the peer knows such links.
    async fn dial(
        &self,
        endpoint: EndPoint,
        path: Option<PathOf>,
    ) -> Result<Arc<LinkBle>, BleError> {
        let node = Arc::clone(&self.node);
        self.on_runtime(async move {
            let locator = ConnectLocator::parse(&endpoint)?;
            let dialling = node
                .stop_dialling
                .run_until_cancelled(dial(&node, &locator, path));
            let dialled = dialling.await.unwrap_or(Err(BleError::ShuttingDown));
            if let Err(error) = &dialled {
                // Zenoh dials again and logs the reason only at debug level. The status shows it to the user.
                let reason = describe(error);
                tracing::debug!("ble: no link with {}: {reason}", locator.target);
                let is_failure = match error {
                    BleError::AlreadyLinked { .. } | BleError::ShuttingDown => false,
                    // A fleet need not have any more robots.
                    BleError::NotFound { .. }
                    | BleError::DialTimedOut {
                        step: DialStep::OtherDial,
                        ..
                    } => !matches!(locator.target, Target::Fleet(_)),
                    _ => true,
                };
                if is_failure {
                    node.on_failed_dial(&locator.target.to_string(), &reason);
                }
            }
            dialled
        })
        .await
    }

    /// Runs `work` on the manager's runtime. Sockets and tasks of the radio need a runtime that lives as long as Zenoh,
    /// regardless of the caller's.
    async fn on_runtime<T: Send + 'static>(
        &self,
        work: impl std::future::Future<Output = Result<T, BleError>> + Send + 'static,
    ) -> Result<T, BleError> {
        let done = AbortOnDropHandle::new(self.runtime.spawn(work)).await;
        done.unwrap_or(Err(BleError::ShuttingDown))
    }
}

#[async_trait]
impl LinkManagerUnicastTrait for LinkManagerUnicastBle {
    async fn new_link(&self, endpoint: EndPoint) -> ZResult<LinkUnicast> {
        let link: Arc<dyn LinkUnicastTrait> =
            self.dial(endpoint, None).await.map_err(into_zenoh)?;
        Ok(LinkUnicast::from(link))
    }

    async fn new_listener(&self, endpoint: EndPoint) -> ZResult<Locator> {
        let locator = ListenLocator::parse(&endpoint).map_err(|e| into_zenoh(e.into()))?;
        let adapter = locator.adapter.clone();
        let dialable = Locator::new(BLE_LOCATOR_PREFIX, locator.name(), "")?;
        let mut listeners = self.listeners.lock().await;
        if listeners.contains_key(&adapter) {
            return Err(into_zenoh(BleError::ListenerExists(adapter)));
        }
        let node = Arc::clone(&self.node);
        let (listener, bound) = self
            .on_runtime(async move { Listener::start(node, locator).await })
            .await
            .map_err(into_zenoh)?;
        let (bound, search) = bound.unzip();
        let serve = Arc::clone(&listener).serve(bound);
        let serving = AbortOnDropHandle::new(self.runtime.spawn(serve));
        if let Some(search) = search {
            let checked = Arc::clone(&listener);
            self.on_runtime(async move { checked.check_name(search).await })
                .await
                .map_err(into_zenoh)?;
        }
        let watch = self
            .runtime
            .spawn(async move { listener.watch_name().await });
        listeners.insert(
            adapter,
            RunningListener {
                endpoint,
                locator: dialable.clone(),
                _serving: serving,
                _watching: AbortOnDropHandle::new(watch),
            },
        );
        Ok(dialable)
    }

    async fn del_listener(&self, endpoint: &EndPoint) -> ZResult<()> {
        let adapter = endpoint.address().as_str().to_owned();
        match self.listeners.lock().await.remove(&adapter) {
            Some(_ended) => Ok(()),
            None => Err(into_zenoh(BleError::NoListener(adapter))),
        }
    }

    async fn get_listeners(&self) -> Vec<EndPoint> {
        let listeners = self.listeners.lock().await;
        listeners.values().map(|l| l.endpoint.clone()).collect()
    }

    async fn get_locators(&self) -> Vec<Locator> {
        let listeners = self.listeners.lock().await;
        listeners.values().map(|l| l.locator.clone()).collect()
    }

    async fn get_locators_noloopback(&self) -> Vec<Locator> {
        self.get_locators().await
    }
}

fn open_radio(name: Option<&str>) -> Result<Arc<dyn Radio>, RadioError> {
    match name {
        Some(name) if is_simulated(name) => zenoh_link_ble_air::radio(name),
        name => zenoh_link_ble_bluez::radio(name),
    }
}

fn random_node_id() -> NodeId {
    let mut bytes = [0; 8];
    if getrandom::fill(&mut bytes).is_err() {
        // Without random numbers from the system, the time and the process id still distinguish two robots.
        let time = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .map_or(0, |t| t.as_nanos() as u64);
        bytes = (time ^ u64::from(std::process::id()).rotate_left(48)).to_le_bytes();
    }
    NodeId(u64::from_le_bytes(bytes))
}
