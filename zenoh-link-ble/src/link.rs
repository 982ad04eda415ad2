//! Implements Zenoh's link trait for an open link, whose batches travel on lanes or, to a plain peer, without framing.
//!
//! Its submodules carry the batches (`traffic`, `plain`), decide which links exist ([`table`]), end a link once
//! (`close_once`), and keep what all links of a node share (`node`, `history`, `open_links`).
pub(crate) mod close_once;
pub(crate) mod history;
pub(crate) mod interval_events;
pub mod interval_units;
pub(crate) mod node;
mod number;
mod open_links;
pub mod path;
mod plain;
pub(crate) mod status;
pub mod table;
mod traffic;

use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use async_trait::async_trait;
use link_lanes::{
    compression::{Compressor, Decompressor},
    hello::Hello,
    key_agreement::Exporter,
    lanes::{sdu::Protection, Lane},
    usage::keys::{self, Side},
};
use parking_lot::Mutex;
use tokio_util::sync::CancellationToken;
use zenoh_link_ble_radio::{interval::ConnectionInterval, Channel};
use zenoh_link_commons::{LinkAuthId, LinkUnicastTrait};
use zenoh_protocol::{
    core::{Locator, Priority},
    transport::BatchSize,
};
use zenoh_result::ZResult;

use crate::{
    adapter::Adapter,
    connections::ConnectionGuard,
    error::{describe, into_zenoh, BleError},
    handshake::own_window,
    link::{
        close_once::CloseOnce,
        interval_events::IntervalEvents,
        node::Node,
        number::LinkNumber,
        path::AgreedPath,
        plain::Plain,
        status::{LinkStatus, LinkUsage},
        traffic::{Tasks, Traffic, TrafficOptions},
    },
    locator::{Queueing, BLE_LOCATOR_PREFIX},
};

/// How long closing a link waits until its BLE connection is closed.
const DISCONNECT_TIMEOUT: Duration = Duration::from_millis(500);

/// The framing of the batches of a link.
pub(crate) enum Framing {
    /// On lanes: see section 4 of `PROTOCOL.md` in `link-lanes`. The windows are the numbers of bytes that each side accepts unacknowledged.
    Lanes {
        own_window: u16,
        peer_window: u16,
        protection: Protection,
        /// Whether the peer accepts compressed batches.
        is_compressed: bool,
    },
    /// Bare batches, for peers without a hello. `first` is a batch that was received already.
    Plain { first: Option<Vec<u8>> },
}

impl Framing {
    /// Returns the framing for a peer that has sent a hello, or for a plain peer (`None`) and its first batch.
    pub(crate) fn with(
        channel: &Arc<dyn Channel>,
        peer: Option<&Hello>,
        protection: Protection,
        first: Option<Vec<u8>>,
    ) -> Self {
        match peer {
            Some(peer) => Self::Lanes {
                own_window: own_window(channel),
                peer_window: peer.window,
                protection,
                is_compressed: peer.accepts_compressed,
            },
            None => Self::Plain { first },
        }
    }

    fn is_encrypted(&self) -> bool {
        match self {
            Self::Lanes { protection, .. } => protection.is_encrypted(),
            Self::Plain { .. } => false,
        }
    }
}

/// The parts of a link after its handshake.
pub(crate) struct Opened {
    pub channel: Arc<dyn Channel>,
    pub adapter: Arc<Adapter>,
    /// Keeps the BLE connection open.
    pub connection: Option<ConnectionGuard>,
    pub framing: Framing,
    pub mtu: u16,
    pub queueing: Queueing,
    pub peer_name: String,
    /// Whether Bluetooth itself encrypts the channel, because the two are paired.
    pub is_paired: bool,
    /// Cancelled when a newer link replaces this one.
    pub replaced: CancellationToken,
    /// The link of which the two have agreed that the channel becomes a path.
    pub path: Option<AgreedPath>,
    /// Derives keys for other uses, if the two have a secret.
    pub exporter: Option<Exporter>,
}

/// An open link, as Zenoh uses it.
pub(crate) struct LinkBle {
    channel: Arc<dyn Channel>,
    adapter: Arc<Adapter>,
    batches: Batches,
    mtu: u16,
    is_encrypted: bool,
    src: Locator,
    dst: Locator,
    number: LinkNumber,
    since: Instant,
    close_once: Arc<CloseOnce>,
    linger: Duration,
    is_closed: AtomicBool,
    path: Option<AgreedPath>,
    exporter: Option<Exporter>,
}

enum Batches {
    Lanes {
        traffic: Arc<Traffic>,
        /// Compresses what is sent, if the peer accepts that. It is locked until a batch is queued.
        compressor: Option<tokio::sync::Mutex<Compressor>>,
        decompressor: Mutex<Decompressor>,
        /// The tasks of the link, which end with it.
        _tasks: Tasks,
    },
    Plain(Plain),
}

impl LinkBle {
    pub(crate) fn new(node: Arc<Node>, number: LinkNumber, opened: Opened) -> ZResult<Arc<Self>> {
        let Opened {
            channel,
            adapter,
            connection,
            framing,
            mtu,
            queueing,
            peer_name,
            is_paired,
            replaced,
            path,
            exporter,
        } = opened;
        let peer = if peer_name.is_empty() {
            channel.peer().to_string()
        } else {
            peer_name
        };
        // Zenoh identifies links by their locators. The number distinguishes this link from an earlier one with the same
        // peer.
        let name = channel.adapter().to_owned();
        let src = Locator::new(BLE_LOCATOR_PREFIX, &name, format!("link={}", number.0))?;
        let dst = Locator::new(BLE_LOCATOR_PREFIX, &peer, "")?;
        let is_encrypted = is_paired || framing.is_encrypted();
        let how = if is_encrypted { "" } else { ", not encrypted" };
        tracing::info!("ble: linked with {peer} on {name}{how}");
        let close_once = CloseOnce::new(Arc::clone(&node), number, peer.clone(), connection);
        let batches = match framing {
            Framing::Lanes {
                own_window,
                peer_window,
                protection,
                is_compressed,
            } => {
                let options = TrafficOptions {
                    bounds: queueing.bounds,
                    mtu,
                    own_window,
                    peer_window,
                    protection,
                    intervals: IntervalEvents::new(Arc::clone(&node), number),
                };
                let (channel, close_once) = (Arc::clone(&channel), Arc::clone(&close_once));
                let (traffic, _tasks) =
                    Traffic::start(channel, peer, options, close_once, replaced);
                Batches::Lanes {
                    traffic,
                    compressor: is_compressed.then(Default::default),
                    decompressor: Mutex::default(),
                    _tasks,
                }
            }
            Framing::Plain { first } => {
                Batches::Plain(Plain::new(Arc::clone(&channel), mtu, first, replaced))
            }
        };
        let link = Arc::new(Self {
            channel,
            adapter,
            batches,
            mtu,
            is_encrypted,
            src,
            dst,
            number,
            since: Instant::now(),
            close_once,
            linger: queueing.linger,
            is_closed: AtomicBool::new(false),
            path,
            exporter,
        });
        node.on_link_open(number, link.dst.address().as_str(), &link);
        Ok(link)
    }

    /// Returns what derives keys for other uses, if the two have a secret.
    pub(crate) fn exporter(&self) -> Option<&Exporter> {
        self.exporter.as_ref()
    }

    /// Returns the next batch of any lane.
    pub(crate) async fn receive_any(&self) -> Result<Vec<u8>, BleError> {
        match &self.batches {
            Batches::Lanes { traffic, .. } => traffic.read_any().await,
            Batches::Plain(plain) => plain.read().await,
        }
    }

    /// Returns the number of batches that wait to be sent.
    pub(crate) fn waiting(&self) -> u64 {
        match &self.batches {
            Batches::Lanes { traffic, .. } => traffic.waiting(),
            Batches::Plain(_) => 0,
        }
    }

    /// Waits until a batch is sent, or until the link has ended.
    pub(crate) async fn sent(&self) {
        if let Batches::Lanes { traffic, .. } = &self.batches {
            traffic.sent().await;
        }
    }

    /// Returns the link of which this one is a path, if any.
    pub(crate) fn path(&self) -> Option<AgreedPath> {
        self.path
    }

    /// Returns an error if the link is known to have ended.
    pub(crate) fn check(&self) -> Result<(), BleError> {
        match &self.batches {
            Batches::Lanes { traffic, .. } => traffic.check(),
            Batches::Plain(_) => Ok(()),
        }
    }

    /// Returns the state of the link.
    pub(crate) fn status(&self) -> LinkStatus {
        let (lanes, sent, received) = match &self.batches {
            Batches::Lanes { traffic, .. } => {
                let (lanes, sent, received) = traffic.status();
                (Some(lanes), sent, received)
            }
            Batches::Plain(plain) => {
                let (sent, received) = plain.counts();
                (None, sent, received)
            }
        };
        LinkStatus {
            link: self.number.0,
            peer: self.dst.address().as_str().to_owned(),
            address: self.channel.peer().address.to_string(),
            adapter: self.channel.adapter().to_owned(),
            mtu: self.mtu,
            encrypted: self.is_encrypted,
            up_s: self.since.elapsed().as_secs_f64(),
            sent,
            received,
            lanes,
        }
    }

    /// Returns what the link has sent for each key: see [`Traffic::usage`]. Returns `None` if it carries no batches of Zenoh, or has
    /// no lanes.
    pub(crate) fn usage(&self, keep: Duration) -> Option<LinkUsage> {
        let Batches::Lanes { traffic, .. } = &self.batches else {
            return None;
        };
        if self.path.is_some() {
            return None;
        }
        let (report, rate_per_s) = traffic.usage(keep);
        Some(LinkUsage {
            peer: self.dst.address().as_str().to_owned(),
            report,
            rate_per_s,
        })
    }

    /// Sets the connection interval of the link, of which this node is the central, and announces it to the peer.
    pub(crate) async fn set_interval(&self, interval: ConnectionInterval) {
        let radio = &self.adapter.radio;
        if radio.set_interval(self.channel.peer(), interval).await {
            self.send_interval(interval);
        }
    }

    /// Sends a connection interval to the peer.
    pub(crate) fn send_interval(&self, interval: ConnectionInterval) {
        if let Batches::Lanes { traffic, .. } = &self.batches {
            traffic.send_interval(interval);
        }
    }

    pub(crate) async fn send_batch(&self, lane: Lane, batch: &[u8]) -> Result<(), BleError> {
        match &self.batches {
            Batches::Lanes { traffic, .. } => traffic.write(lane, batch).await,
            Batches::Plain(plain) => plain.write(batch).await,
        }
    }

    /// Sends a batch of Zenoh. Those of its own messages are compressed, except in its handshake, when it gives no priority.
    async fn send_of_zenoh(
        &self,
        priority: Option<Priority>,
        batch: &[u8],
    ) -> Result<(), BleError> {
        if priority == Some(Priority::Control) {
            self.on_declarations(Side::Own, batch);
        }
        match (&self.batches, priority) {
            (
                Batches::Lanes {
                    compressor: Some(compressor),
                    ..
                },
                Some(Priority::Control),
            ) => {
                let mut compressor = compressor.lock().await;
                let compressed = compressor.compress(batch, Instant::now());
                self.send_batch(Lane::first(), &compressed).await?;
                compressor.on_sent();
                Ok(())
            }
            _ => self.send_batch(lane_of(priority), batch).await,
        }
    }

    /// Keeps the keys that a batch of Zenoh's own messages declares.
    fn on_declarations(&self, from: Side, batch: &[u8]) {
        if let Batches::Lanes { traffic, .. } = &self.batches {
            if keys::may_declare(batch) {
                traffic.on_declarations(from, batch);
            }
        }
    }

    /// Restores a batch of Zenoh's own messages.
    async fn restored(&self, batch: Vec<u8>) -> Result<Vec<u8>, BleError> {
        let Batches::Lanes {
            traffic,
            decompressor,
            ..
        } = &self.batches
        else {
            return Ok(batch);
        };
        let max = usize::from(self.mtu);
        let restored = decompressor.lock().decompress(batch, max);
        match restored {
            Ok(batch) => {
                self.on_declarations(Side::Peer, &batch);
                Ok(batch)
            }
            Err(error) => Err(traffic.end_for(error.into()).await),
        }
    }

    async fn receive_batch(
        &self,
        priority: Option<Priority>,
        buffer: &mut [u8],
    ) -> Result<usize, BleError> {
        let batch = match (&self.batches, priority) {
            (Batches::Lanes { traffic, .. }, Some(priority)) => {
                traffic.read(Lane::of(priority)).await?
            }
            // Zenoh gives no priority during its handshake, and always one after it.
            (Batches::Lanes { traffic, .. }, None) => traffic.read_handshake().await?,
            (Batches::Plain(plain), _) => plain.read().await?,
        };
        let batch = match priority {
            Some(Priority::Control) => self.restored(batch).await?,
            _ => batch,
        };
        let room = buffer
            .get_mut(..batch.len())
            .ok_or(BleError::BatchTooLarge {
                size: batch.len(),
                mtu: usize::from(self.mtu),
            })?;
        room.copy_from_slice(&batch);
        Ok(batch.len())
    }
}

impl Drop for LinkBle {
    fn drop(&mut self) {
        self.channel.shutdown();
        self.close_once.close("Zenoh dropped it");
    }
}

/// Returns the lane to send on. Zenoh gives no priority during its handshake, which takes place on the first lane.
fn lane_of(priority: Option<Priority>) -> Lane {
    Lane::of(priority.unwrap_or(Priority::Control))
}

#[async_trait]
impl LinkUnicastTrait for LinkBle {
    fn get_mtu(&self) -> BatchSize {
        self.mtu
    }

    fn get_src(&self) -> &Locator {
        &self.src
    }

    fn get_dst(&self) -> &Locator {
        &self.dst
    }

    fn is_reliable(&self) -> bool {
        true
    }

    fn is_streamed(&self) -> bool {
        false
    }

    fn supports_priorities(&self) -> bool {
        matches!(self.batches, Batches::Lanes { .. })
    }

    fn get_interface_names(&self) -> Vec<String> {
        vec![self.channel.adapter().to_owned()]
    }

    fn get_auth_id(&self) -> &LinkAuthId {
        // Zenoh's enumeration of identities has none for Bluetooth. A serial line is the closest: it has no addresses either.
        &LinkAuthId::Serial
    }

    async fn write(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<usize> {
        self.write_all(buffer, priority).await?;
        Ok(buffer.len())
    }

    async fn write_all(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<()> {
        let sent = self.send_of_zenoh(priority, buffer).await;
        match &sent {
            Ok(()) | Err(BleError::BatchTooLarge { .. }) => {}
            Err(error) => self.close_once.close(&describe(error)),
        }
        sent.map_err(into_zenoh)
    }

    async fn read(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<usize> {
        let received = self.receive_batch(priority, buffer).await;
        if let Err(error) = &received {
            self.close_once.close(&describe(error));
        }
        received.map_err(into_zenoh)
    }

    async fn read_exact(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<()> {
        let expected = buffer.len();
        let size = self.read(buffer, priority).await?;
        if size == expected {
            return Ok(());
        }
        Err(into_zenoh(BleError::Protocol {
            peer: self.channel.peer(),
            what: format!("a batch of {size} bytes where {expected} were expected"),
        }))
    }

    async fn close(&self) -> ZResult<()> {
        if !self.is_closed.swap(true, Ordering::AcqRel) {
            self.close_once.end_here();
            if let Batches::Lanes { traffic, .. } = &self.batches {
                traffic.finish(self.linger).await;
            }
            self.channel.shutdown();
            self.close_once.close("closed by this side");
            // The program may exit next.
            let closed = self
                .adapter
                .connections
                .wait_until_closed(self.channel.peer());
            let _ = tokio::time::timeout(DISCONNECT_TIMEOUT, closed).await;
        }
        Ok(())
    }

    #[cfg(all(feature = "uring", target_os = "linux"))]
    fn get_fd(&self) -> ZResult<std::os::fd::RawFd> {
        Err(zenoh_result::zerror!(
            "a ble link has no file descriptor for io_uring: disable `uring` for it"
        )
        .into())
    }
}
