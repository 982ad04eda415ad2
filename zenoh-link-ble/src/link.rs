//! Owns an open link: one Zenoh batch per SDU, both ways, until either side ends it.
use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    time::Duration,
};

use async_trait::async_trait;
use tokio::sync::Mutex;
use tokio_util::sync::CancellationToken;
use zenoh_link_commons::{LinkAuthId, LinkUnicastTrait};
use zenoh_protocol::{
    core::{Locator, Priority},
    transport::BatchSize,
};
use zenoh_result::ZResult;

use crate::{
    error::{in_words, into_zenoh, BleError},
    frame::{Bye, Frame, HEADER},
    links::LinkNumber,
    locator::BLE_LOCATOR_PREFIX,
    node::Node,
    radio::Channel,
};

/// How long a batch may wait for room in the controller and at the receiver before the link is given up. Zenoh's
/// own lease (10 s) ends a silent link sooner; this bounds one whose receiver is alive but stuck.
const SEND_TIMEOUT: Duration = Duration::from_secs(20);
/// How long a closing side waits until the peer has taken what was sent before the goodbye.
const LINGER: Duration = Duration::from_secs(2);

/// How SDUs are framed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Framing {
    /// One header byte, as `PROTOCOL.md` says.
    Rect,
    /// The bare batch, for peers without a hello.
    Plain,
}

/// What a link is made of once the opening is done.
pub(crate) struct Opened {
    pub channel: Arc<dyn Channel>,
    pub framing: Framing,
    pub mtu: u16,
    pub peer_name: String,
    /// A batch that came before the link was made (a plain peer's first).
    pub first: Option<Vec<u8>>,
    pub end: CancellationToken,
}

pub(crate) struct LinkBle {
    node: Arc<Node>,
    number: LinkNumber,
    channel: Arc<dyn Channel>,
    framing: Framing,
    mtu: u16,
    src: Locator,
    dst: Locator,
    receive: Mutex<Receive>,
    end: CancellationToken,
    closed: AtomicBool,
    ended: AtomicBool,
}

struct Receive {
    sdu: Vec<u8>,
    first: Option<Vec<u8>>,
}

impl LinkBle {
    pub(crate) fn new(node: Arc<Node>, number: LinkNumber, opened: Opened) -> ZResult<Arc<Self>> {
        let adapter = opened.channel.adapter().to_owned();
        let peer = if opened.peer_name.is_empty() {
            opened.channel.peer().to_string()
        } else {
            opened.peer_name
        };
        // The number tells this link from an earlier one with the same peer: Zenoh knows links by their locators.
        let src = Locator::new(BLE_LOCATOR_PREFIX, &adapter, format!("link={}", number.0))?;
        let dst = Locator::new(BLE_LOCATOR_PREFIX, &peer, "")?;
        let mtu = opened.mtu;
        tracing::info!("ble: linked with {peer} by {adapter}");
        Ok(Arc::new(Self {
            node,
            number,
            channel: opened.channel,
            framing: opened.framing,
            mtu,
            src,
            dst,
            receive: Mutex::new(Receive {
                // One byte more than is allowed, so that a larger SDU shows instead of being cut.
                sdu: vec![0; usize::from(mtu) + HEADER + 1],
                first: opened.first,
            }),
            end: opened.end,
            closed: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        }))
    }

    /// The link is of no use any more, even if Zenoh holds on to it for a while: the peer may be dialled again.
    fn on_ended(&self, reason: &str) {
        if !self.ended.swap(true, Ordering::AcqRel) {
            tracing::info!("ble: the link with {} ended: {reason}", self.peer());
            self.node.on_link_closed(self.number);
        }
    }

    fn peer(&self) -> String {
        self.dst.address().as_str().to_owned()
    }

    async fn send_batch(&self, batch: &[u8]) -> Result<(), BleError> {
        if batch.is_empty() {
            // Zenoh does this when it abandons a fragmented message; an empty SDU would end the channel.
            return Ok(());
        }
        let mtu = usize::from(self.mtu);
        if batch.len() > mtu {
            return Err(BleError::BatchTooLarge {
                size: batch.len(),
                mtu,
            });
        }
        match self.framing {
            Framing::Plain => self.send_sdu(batch).await,
            Framing::Rect => self.send_sdu(&Frame::Batch(batch).encode()).await,
        }
    }

    async fn send_sdu(&self, sdu: &[u8]) -> Result<(), BleError> {
        tokio::select! {
            sent = tokio::time::timeout(SEND_TIMEOUT, self.channel.send(sdu)) => match sent {
                Ok(sent) => Ok(sent?),
                Err(_) => {
                    self.channel.shutdown();
                    Err(crate::radio::RadioError::TimedOut {
                        action: "sending to a peer that takes nothing",
                        limit: SEND_TIMEOUT,
                    }
                    .into())
                }
            },
            () = self.end.cancelled() => Err(self.replaced()),
        }
    }

    async fn receive_batch(&self, buffer: &mut [u8]) -> Result<usize, BleError> {
        let mut receive = self.receive.lock().await;
        if let Some(first) = receive.first.take() {
            return self.deliver(&first, buffer);
        }
        let size = tokio::select! {
            size = self.channel.recv(&mut receive.sdu) => size?,
            () = self.end.cancelled() => return Err(self.replaced()),
        };
        let sdu = receive.sdu.get(..size).unwrap_or_default();
        let batch = match self.framing {
            Framing::Plain => Ok(sdu),
            Framing::Rect => match Frame::decode(sdu) {
                Ok(Frame::Batch(batch)) => Ok(batch),
                Ok(Frame::Bye(bye)) => {
                    self.channel.shutdown();
                    return Err(BleError::ClosedByPeer {
                        peer: self.peer(),
                        reason: bye.reason(),
                    });
                }
                Err(error) => Err(error.to_string()),
            },
        };
        match batch {
            Ok(batch) if batch.len() <= usize::from(self.mtu) => self.deliver(batch, buffer),
            Ok(batch) => {
                let what = format!(
                    "a batch of {} bytes is over the mtu of {}",
                    batch.len(),
                    self.mtu
                );
                Err(self.broken(what).await)
            }
            Err(what) => Err(self.broken(what).await),
        }
    }

    fn deliver(&self, batch: &[u8], buffer: &mut [u8]) -> Result<usize, BleError> {
        let room = buffer
            .get_mut(..batch.len())
            .ok_or(BleError::BatchTooLarge {
                size: batch.len(),
                mtu: usize::from(self.mtu),
            })?;
        room.copy_from_slice(batch);
        Ok(batch.len())
    }

    async fn broken(&self, what: String) -> BleError {
        self.say_bye(Bye::ProtocolError).await;
        self.channel.shutdown();
        BleError::Protocol {
            peer: self.channel.peer(),
            what,
        }
    }

    fn replaced(&self) -> BleError {
        self.channel.shutdown();
        BleError::ClosedByPeer {
            peer: self.peer(),
            reason: Bye::Replaced.reason(),
        }
    }

    /// Tells the peer, without waiting for room longer than a moment: the channel ends anyway.
    async fn say_bye(&self, bye: Bye) {
        if self.framing == Framing::Rect {
            let sdu = Frame::Bye(bye).encode();
            let _ = tokio::time::timeout(LINGER, self.channel.send(&sdu)).await;
        }
    }

    /// Says goodbye and waits until the peer, having read everything before it, closes its end.
    async fn finish(&self) {
        self.say_bye(Bye::Closing).await;
        if self.framing == Framing::Rect {
            let drained = async {
                let mut receive = self.receive.lock().await;
                while self.channel.recv(&mut receive.sdu).await.is_ok() {}
            };
            let _ = tokio::time::timeout(LINGER, drained).await;
        }
        self.channel.shutdown();
    }
}

impl Drop for LinkBle {
    fn drop(&mut self) {
        self.channel.shutdown();
        self.on_ended("nobody needs it");
    }
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

    fn get_interface_names(&self) -> Vec<String> {
        vec![self.channel.adapter().to_owned()]
    }

    fn get_auth_id(&self) -> &LinkAuthId {
        // Zenoh's list of identities is closed; a serial line is the nearest: one radio, no addresses of its own.
        &LinkAuthId::Serial
    }

    async fn write(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<usize> {
        self.write_all(buffer, priority).await?;
        Ok(buffer.len())
    }

    async fn write_all(&self, buffer: &[u8], _priority: Option<Priority>) -> ZResult<()> {
        let sent = self.send_batch(buffer).await;
        match &sent {
            Ok(()) | Err(BleError::BatchTooLarge { .. }) => {}
            Err(error) => self.on_ended(&in_words(error)),
        }
        sent.map_err(into_zenoh)
    }

    async fn read(&self, buffer: &mut [u8], _priority: Option<Priority>) -> ZResult<usize> {
        let received = self.receive_batch(buffer).await;
        if let Err(error) = &received {
            self.on_ended(&in_words(error));
        }
        received.map_err(into_zenoh)
    }

    async fn read_exact(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<()> {
        let wanted = buffer.len();
        let size = self.read(buffer, priority).await?;
        if size == wanted {
            return Ok(());
        }
        Err(into_zenoh(BleError::Protocol {
            peer: self.channel.peer(),
            what: format!("a batch of {size} bytes where {wanted} were wanted"),
        }))
    }

    async fn close(&self) -> ZResult<()> {
        if !self.closed.swap(true, Ordering::AcqRel) {
            self.finish().await;
            self.on_ended("closed here");
        }
        Ok(())
    }

    #[cfg(all(feature = "uring", target_os = "linux"))]
    fn get_fd(&self) -> ZResult<std::os::fd::RawFd> {
        Err(zenoh_result::zerror!(
            "a ble link has no file descriptor for io_uring: leave `uring` off for it"
        )
        .into())
    }
}
