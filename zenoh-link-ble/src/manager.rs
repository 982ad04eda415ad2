//! Owns what Zenoh calls: the link manager of the `ble` protocol.
use std::{collections::HashMap, sync::Arc};

use async_trait::async_trait;
use tokio::{runtime::Handle, sync::Mutex};
use tokio_util::task::AbortOnDropHandle;
use zenoh_link_commons::{
    LinkManagerUnicastTrait, LinkUnicast, LinkUnicastTrait, LocatorInspector, NewLinkChannelSender,
};
use zenoh_protocol::core::{EndPoint, Locator};
use zenoh_result::ZResult;

use crate::{
    dialer::dial,
    error::{in_words, into_zenoh, BleError},
    hello::NodeId,
    links::Census,
    listener::Listener,
    locator::{is_simulated, ConnectLocator, ListenLocator, Target, BLE_LOCATOR_PREFIX},
    node::Node,
    radio::{bluez, sim, Radio, RadioError},
    status,
};

/// Tells Zenoh what kind of link `ble` is: unicast and reliable.
#[derive(Clone, Copy, Debug, Default)]
pub struct BleLocatorInspector;

#[async_trait]
impl LocatorInspector for BleLocatorInspector {
    fn protocol(&self) -> &str {
        BLE_LOCATOR_PREFIX
    }

    async fn is_multicast(&self, _locator: &Locator) -> ZResult<bool> {
        Ok(false)
    }

    fn is_reliable(&self, _locator: &Locator) -> ZResult<bool> {
        Ok(true)
    }
}

/// Makes and takes `ble` links for one Zenoh runtime.
pub struct LinkManagerUnicastBle {
    node: Arc<Node>,
    runtime: Handle,
    listeners: Mutex<HashMap<String, Listening>>,
}

struct Listening {
    endpoint: EndPoint,
    /// What a peer can dial: the name, not this machine's adapter.
    locator: Locator,
    // Dropping it ends the listener.
    _serving: AbortOnDropHandle<()>,
    _watching: AbortOnDropHandle<()>,
}

impl LinkManagerUnicastBle {
    /// A manager over this machine's radios: BlueZ's, and the simulated air's for adapters named `sim...`. Those with the
    /// same channel are of one Zenoh runtime, and are one node to its peers.
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

    /// A manager over radios of the caller's, with its tasks on `runtime`: for tests. `node` must be no other's; whatever
    /// this node leaves to chance follows from it.
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

    /// How many links and dials there are now.
    pub fn census(&self) -> Census {
        self.node.links().census()
    }

    /// Radio sockets and tasks belong to one runtime that lives as long as Zenoh, whoever calls.
    async fn on_runtime<T: Send + 'static>(
        &self,
        work: impl std::future::Future<Output = Result<T, BleError>> + Send + 'static,
    ) -> ZResult<T> {
        match AbortOnDropHandle::new(self.runtime.spawn(work)).await {
            Ok(done) => done.map_err(into_zenoh),
            Err(_) => Err(into_zenoh(BleError::ShuttingDown)),
        }
    }
}

#[async_trait]
impl LinkManagerUnicastTrait for LinkManagerUnicastBle {
    async fn new_link(&self, endpoint: EndPoint) -> ZResult<LinkUnicast> {
        let node = Arc::clone(&self.node);
        let link = self
            .on_runtime(async move {
                let locator = ConnectLocator::parse(&endpoint)?;
                let dialling = node
                    .stop_dialling
                    .run_until_cancelled(dial(&node, &locator));
                let dialled = dialling.await.unwrap_or(Err(BleError::ShuttingDown));
                if let Err(error) = &dialled {
                    // Zenoh tries again and says so at debug level only; a person wants to know why nothing comes.
                    let words = in_words(error);
                    tracing::debug!("ble: no link to {}: {words}", locator.target);
                    let is_trouble = match error {
                        BleError::AlreadyLinked { .. } | BleError::ShuttingDown => false,
                        // Of a fleet there need not be anyone more.
                        BleError::NotFound { .. } => !matches!(locator.target, Target::Fleet(_)),
                        _ => true,
                    };
                    if is_trouble {
                        node.on_failed_dial(&locator.target.to_string(), &words);
                    }
                }
                dialled
            })
            .await?;
        let link: Arc<dyn LinkUnicastTrait> = link;
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
        let (listener, up) = self
            .on_runtime(async move { Listener::start(node, locator).await })
            .await?;
        let (up, search) = up.unzip();
        let serve = Arc::clone(&listener).serve(up);
        let serving = AbortOnDropHandle::new(self.runtime.spawn(serve));
        if let Some(search) = search {
            let checked = Arc::clone(&listener);
            self.on_runtime(async move { checked.check_name(search).await })
                .await?;
        }
        let watch = self
            .runtime
            .spawn(async move { listener.watch_name().await });
        listeners.insert(
            adapter,
            Listening {
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
        Some(name) if is_simulated(name) => sim::radio(name),
        name => bluez::radio(name),
    }
}

fn random_node_id() -> NodeId {
    let mut bytes = [0; 8];
    if getrandom::fill(&mut bytes).is_err() {
        // Without the system's random numbers the time and the process still tell two robots apart.
        let time = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .map_or(0, |t| t.as_nanos() as u64);
        bytes = (time ^ u64::from(std::process::id()).rotate_left(48)).to_le_bytes();
    }
    NodeId(u64::from_le_bytes(bytes))
}
