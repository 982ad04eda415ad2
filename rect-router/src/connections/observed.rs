//! Owns one link of a named connection as Zenoh uses it: counts what passes, tells when it ends and why, and can be ended
//! from outside.
use std::{
    future::Future,
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc,
    },
};

use async_trait::async_trait;
use rect::core::connection::Traffic;
use tokio_util::sync::CancellationToken;
use zenoh_link::{LinkAuthId, LinkUnicastTrait, Locator};
use zenoh_protocol::core::Priority;
use zenoh_result::{bail, ZResult};

use super::connection::Connection;

/// Counts while others read.
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

/// A link that tells its connection.
pub struct ObservedLink {
    link: Arc<dyn LinkUnicastTrait>,
    connection: Arc<Connection>,
    sent: Counter,
    received: Counter,
    ended: CancellationToken,
}

impl ObservedLink {
    /// `connection` is told what becomes of `link`.
    pub fn new(link: Arc<dyn LinkUnicastTrait>, connection: Arc<Connection>) -> Arc<Self> {
        Arc::new(Self {
            link,
            connection,
            sent: Counter::default(),
            received: Counter::default(),
            ended: CancellationToken::new(),
        })
    }

    /// What was sent and received.
    pub fn traffic(&self) -> (Traffic, Traffic) {
        (self.sent.now(), self.received.now())
    }

    /// Zenoh finds it ended, and dials what its slot holds then.
    pub fn end(&self) {
        self.ended.cancel();
    }

    async fn unless_ended<T>(&self, work: impl Future<Output = ZResult<T>>) -> ZResult<T> {
        let result = tokio::select! {
            result = work => result,
            () = self.ended.cancelled() => bail!("the connection was removed or changed"),
        };
        if let Err(error) = &result {
            self.connection.on_link_error(&error.to_string());
        }
        result
    }

    /// A batch of a stream is its length, read first, and then its bytes.
    fn count_received(&self, bytes: usize) {
        let is_length = self.link.is_streamed() && bytes == size_of::<u16>();
        self.received.add(u64::from(!is_length), bytes);
    }
}

impl Drop for ObservedLink {
    fn drop(&mut self) {
        let (sent, received) = self.traffic();
        self.connection.on_link_gone(sent, received);
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
