//! A channel that is a path of another link (crate `zenoh-link-any`): it carries that link's frames in place of Zenoh's
//! batches.
use std::sync::Arc;

use link_lanes::{
    hello::{NodeId, PathOf, Refusal},
    key_agreement::Exporter,
    lanes::Lane,
};
use zenoh_link_commons::{LinkUnicast, LinkUnicastTrait};

use crate::{error::BleError, link::LinkBle};

/// Takes the paths that peers open.
pub trait AcceptPaths: Send + Sync {
    /// Returns why a peer must not open a channel, if it must not. `path` is the link of which it should become a path, if any, and
    /// `free_places` the number of channels that may still be accepted.
    fn refusal(
        &self,
        peer: &str,
        node: NodeId,
        path: Option<PathOf>,
        free_places: usize,
    ) -> Option<Refusal>;

    /// Ends a path that is not needed, if there is one: no further channel can be accepted.
    fn make_room(&self);

    /// Takes a path that a peer has opened.
    fn on_path(self: Arc<Self>, path: BlePath);
}

/// The result of dialling for a path.
pub enum DialledPath {
    /// The path.
    Path(BlePath),
    /// The peer knows no links with several paths: this is a `ble` link with it.
    Link(LinkUnicast),
}

/// A link of which the two sides have agreed that a channel is a path.
#[derive(Clone, Copy, Debug)]
pub struct AgreedPath {
    /// The link.
    pub of: PathOf,
    /// The peer's Zenoh runtime.
    pub node: NodeId,
    /// Whether the peer accepts compressed batches on the link.
    pub accepts_compressed: bool,
}

/// An open path.
pub struct BlePath {
    link: Arc<LinkBle>,
}

impl BlePath {
    pub(crate) fn new(link: Arc<LinkBle>) -> Self {
        Self { link }
    }

    /// Returns the link of which this is a path.
    pub fn agreed(&self) -> Option<AgreedPath> {
        self.link.path()
    }

    /// Returns the name of the peer, or its address if it has none.
    pub fn peer(&self) -> &str {
        self.link.get_dst().address().as_str()
    }

    /// Returns the name of the adapter.
    pub fn adapter(&self) -> &str {
        self.link.get_src().address().as_str()
    }

    /// Returns the size of the largest frame, in bytes.
    pub fn max_frame(&self) -> usize {
        usize::from(self.link.get_mtu())
    }

    /// Returns what derives keys for other uses. Returns `None` if the two have no secret.
    pub fn exporter(&self) -> Option<&Exporter> {
        self.link.exporter()
    }

    /// Queues a frame on a lane. Waits while there is no room.
    ///
    /// # Errors
    /// Fails if the frame is too large, or if the path has ended.
    pub async fn send(&self, lane: Lane, frame: &[u8]) -> Result<(), BleError> {
        self.link.send_batch(lane, frame).await
    }

    /// Returns the next frame. Waits until there is one.
    ///
    /// # Errors
    /// Fails if the path has ended.
    pub async fn receive(&self) -> Result<Vec<u8>, BleError> {
        self.link.receive_any().await
    }

    /// Returns whether frames wait to be sent.
    pub fn is_busy(&self) -> bool {
        self.link.waiting() > 0
    }

    /// Waits until a frame is sent, or until the path has ended.
    pub async fn sent(&self) {
        self.link.sent().await;
    }

    /// Closes the path after everything that waits was sent.
    pub async fn close(&self) {
        let _ = self.link.close().await;
    }
}
