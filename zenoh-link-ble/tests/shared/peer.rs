//! Provides a node as Zenoh uses it: it listens, dials and accepts links. Each step has a timeout.
use std::{cell::Cell, future::Future, sync::Arc, time::Duration};

use link_lanes::hello::NodeId;
use tokio::runtime::Handle;
use zenoh_link_ble::LinkManagerUnicastBle;
use zenoh_link_ble_radio::Radio;
use zenoh_link_commons::{LinkManagerUnicastTrait, LinkUnicast};
use zenoh_result::ZResult;

/// Applies a timeout to a step, so that a hang becomes a failure that names the step.
pub async fn within<T>(what: &str, step: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(20), step)
        .await
        .unwrap_or_else(|_| panic!("{what} took longer than 20 s"))
}

thread_local! {
    /// Number of nodes of this thread, that is, of one test.
    static NODES: Cell<u64> = const { Cell::new(0) };
}

/// Returns the next node id. On a simulated radio, the ids are the same in every run; on a real radio, they differ from
/// those of earlier runs.
fn next_node(radio: &str) -> NodeId {
    let node = NODES.get() + 1;
    NODES.set(node);
    let run = match radio.starts_with("sim") {
        true => 0,
        false => std::process::id(),
    };
    NodeId(u64::from(run) << 32 | node)
}

/// A node as Zenoh uses it: a link manager, and the accepted links.
pub struct Peer {
    pub manager: Arc<LinkManagerUnicastBle>,
    incoming: flume::Receiver<LinkUnicast>,
}

impl Peer {
    pub fn on(radio: &Arc<dyn Radio>) -> Self {
        let node = next_node(radio.name());
        let (sender, incoming) = flume::unbounded();
        let radio = Arc::clone(radio);
        let open = move |_: Option<&str>| Ok(Arc::clone(&radio));
        let manager = LinkManagerUnicastBle::with_radios(sender, Handle::current(), node, open);
        Self {
            manager: Arc::new(manager),
            incoming,
        }
    }

    /// Listens on the node's radio, whatever its name.
    pub async fn listen_as(self, options: &str) -> Self {
        self.try_listen(options).await.expect("listens");
        self
    }

    pub async fn try_listen(&self, options: &str) -> ZResult<()> {
        let endpoint = format!("ble/hci0#{options}").parse().expect("an endpoint");
        within("listening", self.manager.new_listener(endpoint))
            .await
            .map(|_| ())
    }

    pub async fn dial(&self, locator: &str) -> ZResult<LinkUnicast> {
        let endpoint = locator.parse().expect("an endpoint");
        within("dialling", self.manager.new_link(endpoint)).await
    }

    pub async fn incoming(&self) -> LinkUnicast {
        within("the incoming link", self.incoming.recv_async())
            .await
            .expect("the manager is running")
    }

    pub fn no_more_incoming(&self) -> bool {
        self.incoming.is_empty()
    }
}

/// Asserts that a batch written at `from` is read at `to`.
pub async fn assert_delivers(from: &LinkUnicast, to: &LinkUnicast, batch: &[u8]) {
    within("writing", from.write_all(batch, None))
        .await
        .expect("writes");
    let mut buffer = vec![0; 9000];
    let size = within("reading", to.read(&mut buffer, None))
        .await
        .expect("reads");
    assert_eq!(&buffer[..size], batch);
}
