//! Implements Zenoh's link trait for an open link.
use std::{
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering},
        Arc,
    },
    time::Duration,
};

use async_trait::async_trait;
use link_lanes::{
    compression::{Compressor, Decompressor},
    lanes::Lane,
    usage::keys::Side,
};
use parking_lot::Mutex;
use tokio::time::Instant;
use zenoh_link_commons::{LinkAuthId, LinkUnicastTrait};
use zenoh_protocol::{
    core::{Locator, Priority},
    transport::BatchSize,
};
use zenoh_result::{zerror, ZResult};

use crate::{
    error::AnyError,
    locator::{LocatorError, ANY_LOCATOR_PREFIX},
    shared::Shared,
};

/// The name of the interface that a link reports, whichever paths it has: Zenoh applies access control by interface, once.
pub const INTERFACE: &str = "any";
/// How long a closing side waits until the peer has read what was queued.
const LINGER: Duration = Duration::from_secs(5);

static NEXT_NUMBER: AtomicU64 = AtomicU64::new(1);

/// An open link, as Zenoh uses it.
pub(crate) struct LinkAny {
    shared: Arc<Shared>,
    src: Locator,
    dst: Locator,
    /// Compresses what is sent, if the peer accepts that. It is locked until a batch is queued.
    compressor: Option<tokio::sync::Mutex<Compressor>>,
    decompressor: Mutex<Decompressor>,
    is_closed: AtomicBool,
}

impl LinkAny {
    pub(crate) fn new(shared: Arc<Shared>, adapter: &str) -> Result<Arc<Self>, LocatorError> {
        // Zenoh identifies links by their locators. The number distinguishes this link from an earlier one with the same peer.
        let number = NEXT_NUMBER.fetch_add(1, Ordering::Relaxed);
        let locator = |address: &str, metadata: String| {
            Locator::new(ANY_LOCATOR_PREFIX, address, metadata)
                .map_err(|error| LocatorError::Endpoint(error.to_string()))
        };
        Ok(Arc::new(Self {
            src: locator(adapter, format!("link={number}"))?,
            dst: locator(&shared.peer, String::new())?,
            compressor: shared.is_compressed.then(Default::default),
            decompressor: Mutex::default(),
            shared,
            is_closed: AtomicBool::new(false),
        }))
    }

    /// Sends a batch. Those of Zenoh's own messages are compressed, except in its handshake, when it gives no priority.
    async fn send(&self, priority: Option<Priority>, batch: &[u8]) -> Result<(), AnyError> {
        if priority == Some(Priority::Control) {
            self.shared.on_declarations(Side::Own, batch);
        }
        match (&self.compressor, priority) {
            (Some(compressor), Some(Priority::Control)) => {
                let mut compressor = compressor.lock().await;
                let compressed = compressor.compress(batch, Instant::now().into_std());
                self.shared.write(Lane::first(), &compressed).await?;
                compressor.on_sent();
                Ok(())
            }
            _ => self.shared.write(lane_of(priority), batch).await,
        }
    }

    async fn receive(&self, priority: Option<Priority>) -> Result<Vec<u8>, AnyError> {
        let batch = self.shared.read(lane_of(priority)).await?;
        if priority != Some(Priority::Control) {
            return Ok(batch);
        }
        let max = usize::from(self.shared.max_batch());
        let restored = self.decompressor.lock().decompress(batch, max);
        let restored = restored.map_err(|error| {
            self.shared.fail(self.shared.protocol(&error));
            self.shared.protocol(&error)
        })?;
        self.shared.on_declarations(Side::Peer, &restored);
        Ok(restored)
    }
}

impl Drop for LinkAny {
    fn drop(&mut self) {
        self.shared
            .fail(AnyError::Dropped(self.shared.peer.clone()));
    }
}

/// Returns the lane to use. Zenoh gives no priority during its handshake, which takes place on the first lane.
fn lane_of(priority: Option<Priority>) -> Lane {
    Lane::of(priority.unwrap_or(Priority::Control))
}

#[async_trait]
impl LinkUnicastTrait for LinkAny {
    fn get_mtu(&self) -> BatchSize {
        self.shared.max_batch()
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
        true
    }

    fn get_interface_names(&self) -> Vec<String> {
        vec![INTERFACE.to_owned()]
    }

    fn get_auth_id(&self) -> &LinkAuthId {
        // As for `ble`, of which every link has or had a path.
        &LinkAuthId::Serial
    }

    async fn write(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<usize> {
        self.write_all(buffer, priority).await?;
        Ok(buffer.len())
    }

    async fn write_all(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<()> {
        let written = self.send(priority, buffer).await;
        Ok(written.map_err(into_zenoh)?)
    }

    async fn read(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<usize> {
        let batch = self.receive(priority).await;
        let batch = batch.map_err(into_zenoh)?;
        let (size, max) = (batch.len(), buffer.len());
        let room = buffer.get_mut(..size);
        room.ok_or_else(|| into_zenoh(AnyError::BatchTooLarge { size, max }))?
            .copy_from_slice(&batch);
        Ok(size)
    }

    async fn read_exact(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<()> {
        let expected = buffer.len();
        match self.read(buffer, priority).await? {
            size if size == expected => Ok(()),
            size => Err(zerror!(
                "a batch of {size} bytes where {expected} were expected"
            ))?,
        }
    }

    async fn close(&self) -> ZResult<()> {
        if !self.is_closed.swap(true, Ordering::AcqRel) {
            self.shared.finish(LINGER).await;
            self.shared
                .fail(AnyError::Dropped(self.shared.peer.clone()));
        }
        Ok(())
    }

    #[cfg(all(feature = "uring", target_os = "linux"))]
    fn get_fd(&self) -> ZResult<std::os::fd::RawFd> {
        Err(
            zerror!("an `any` link has no file descriptor for io_uring: disable `uring` for it")
                .into(),
        )
    }
}

fn into_zenoh(error: AnyError) -> zenoh_result::Error {
    Box::new(error)
}
