//! Wraps the link of a named connection: counts its traffic, reports its errors and its end to the connection (the
//! [`LinkObserver`]), and allows the connection to close it.
use std::{
    future::Future,
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc,
    },
};

use async_trait::async_trait;
use rect_core::registry::connection::Traffic;
use tokio_util::sync::CancellationToken;
use zenoh_link_table::{LinkAuthId, LinkUnicastTrait, Locator};
use zenoh_protocol::core::Priority;
use zenoh_result::{bail, ZResult};

/// Receives the reports of the links that it is given to.
pub trait LinkObserver: Send + Sync {
    /// Called when an operation of a link fails.
    fn on_link_error(&self, reason: &str);
    /// Called when a link no longer exists, with the traffic that it has sent and received.
    fn on_link_dropped(&self, sent: Traffic, received: Traffic);
}

/// Counts batches and bytes; can be read from other threads.
#[derive(Default)]
struct Counter {
    batches: AtomicU64,
    bytes: AtomicU64,
}

impl Counter {
    fn add(&self, batches: u64, bytes: usize) {
        self.batches.fetch_add(batches, Ordering::Relaxed);
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    fn now(&self) -> Traffic {
        Traffic {
            batches: Some(self.batches.load(Ordering::Relaxed)),
            bytes: self.bytes.load(Ordering::Relaxed),
        }
    }
}

/// A link that reports to its observer.
pub struct ObservedLink {
    link: Arc<dyn LinkUnicastTrait>,
    observer: Arc<dyn LinkObserver>,
    sent: Counter,
    received: Counter,
    ended: CancellationToken,
}

impl ObservedLink {
    /// Wraps `link`, whose errors, traffic and end are reported to `observer`.
    pub fn new(link: Arc<dyn LinkUnicastTrait>, observer: Arc<dyn LinkObserver>) -> Arc<Self> {
        Arc::new(Self {
            link,
            observer,
            sent: Counter::default(),
            received: Counter::default(),
            ended: CancellationToken::new(),
        })
    }

    /// Returns the traffic sent and received so far.
    pub fn traffic(&self) -> (Traffic, Traffic) {
        (self.sent.now(), self.received.now())
    }

    /// Closes the link: pending and later operations fail, so that Zenoh drops it and dials its placeholder again.
    pub fn end(&self) {
        self.ended.cancel();
    }

    async fn unless_ended<T>(&self, work: impl Future<Output = ZResult<T>>) -> ZResult<T> {
        let result = tokio::select! {
            result = work => result,
            () = self.ended.cancelled() => bail!("the connection was removed or changed"),
        };
        if let Err(error) = &result {
            self.observer.on_link_error(&error.to_string());
        }
        result
    }

    /// Counts received bytes. On a streamed link Zenoh reads the two bytes of a batch's length first; they do not count as a
    /// batch.
    fn count_received(&self, bytes: usize) {
        let is_length = self.link.is_streamed() && bytes == size_of::<u16>();
        self.received.add(u64::from(!is_length), bytes);
    }
}

impl Drop for ObservedLink {
    fn drop(&mut self) {
        let (sent, received) = self.traffic();
        self.observer.on_link_dropped(sent, received);
    }
}

#[async_trait]
impl LinkUnicastTrait for ObservedLink {
    fn get_mtu(&self) -> u16 {
        self.link.get_mtu()
    }

    fn get_src(&self) -> &Locator {
        self.link.get_src()
    }

    fn get_dst(&self) -> &Locator {
        self.link.get_dst()
    }

    fn is_reliable(&self) -> bool {
        self.link.is_reliable()
    }

    fn is_streamed(&self) -> bool {
        self.link.is_streamed()
    }

    fn get_interface_names(&self) -> Vec<String> {
        self.link.get_interface_names()
    }

    fn get_auth_id(&self) -> &LinkAuthId {
        self.link.get_auth_id()
    }

    fn supports_priorities(&self) -> bool {
        self.link.supports_priorities()
    }

    async fn write(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<usize> {
        let sent = self.unless_ended(self.link.write(buffer, priority)).await?;
        self.sent.add(1, sent);
        Ok(sent)
    }

    async fn write_all(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<()> {
        self.unless_ended(self.link.write_all(buffer, priority))
            .await?;
        self.sent.add(1, buffer.len());
        Ok(())
    }

    async fn read(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<usize> {
        let size = self.unless_ended(self.link.read(buffer, priority)).await?;
        self.count_received(size);
        Ok(size)
    }

    async fn read_exact(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<()> {
        self.unless_ended(self.link.read_exact(buffer, priority))
            .await?;
        self.count_received(buffer.len());
        Ok(())
    }

    async fn close(&self) -> ZResult<()> {
        self.link.close().await
    }
}
