//! Wraps an accepted link so that it holds a permit until Zenoh drops it.

use std::{
    future::Future,
    sync::{
        atomic::{AtomicU8, Ordering},
        Arc,
    },
    time::Duration,
};

use async_trait::async_trait;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use zenoh_link_commons::{LinkAuthId, LinkUnicast, LinkUnicastTrait, NewLink};
use zenoh_protocol::{
    core::{Locator, Priority},
    transport::BatchSize,
};
use zenoh_result::{bail, ZResult};

use super::Permit;

/// Number of messages that the accepting side sends in a handshake. Zenoh sends the second one, `OpenAck`, once the
/// peer has proved its login. (The second message may also be a refusal; the link is closed right after it.)
const HANDSHAKE_MESSAGES: u8 = 2;

/// An accepted link with its permit.
pub(super) struct AdmittedLink {
    link: Arc<dyn LinkUnicastTrait>,
    permit: Permit,
    /// Number of messages sent, up to [`HANDSHAKE_MESSAGES`].
    sent: AtomicU8,
    /// Cancelled when the handshake must end.
    handshake: CancellationToken,
    deadline: Instant,
}

impl AdmittedLink {
    /// Returns the link, holding `permit`.
    pub(super) fn wrap(
        link: LinkUnicast,
        permit: Permit,
        handshake: CancellationToken,
        timeout: Duration,
    ) -> LinkUnicast {
        let wrap = |link| -> Arc<dyn LinkUnicastTrait> {
            Arc::new(Self {
                link,
                permit,
                sent: AtomicU8::new(0),
                handshake,
                deadline: Instant::now() + timeout,
            })
        };
        LinkUnicast(match link.0 {
            NewLink::Single(link) => NewLink::Single(wrap(link)),
            // The handshake runs on the reliable link, and both links end together.
            NewLink::MixedReliability {
                reliable,
                best_effort,
            } => NewLink::MixedReliability {
                reliable: wrap(reliable),
                best_effort,
            },
        })
    }

    fn is_complete(&self) -> bool {
        self.sent.load(Ordering::Acquire) >= HANDSHAKE_MESSAGES
    }

    /// Waits for a step of the handshake, until the handshake is cancelled or times out.
    async fn step<T>(&self, step: impl Future<Output = ZResult<T>>) -> ZResult<T> {
        tokio::select! {
            biased;
            () = self.handshake.cancelled() => bail!("the handshake was ended to make room for a new connection"),
            () = tokio::time::sleep_until(self.deadline) => bail!("the handshake timed out"),
            done = step => done,
        }
    }

    /// Counts a message that is about to be sent.
    fn before_message(&self) -> ZResult<()> {
        let sent = self.sent.load(Ordering::Acquire) + 1;
        if sent == HANDSHAKE_MESSAGES {
            self.permit.establish()?;
        }
        self.sent.store(sent, Ordering::Release);
        Ok(())
    }
}

#[async_trait]
impl LinkUnicastTrait for AdmittedLink {
    fn get_mtu(&self) -> BatchSize {
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
        if self.is_complete() {
            return self.link.write(buffer, priority).await;
        }
        self.step(self.link.write(buffer, priority)).await
    }

    async fn write_all(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<()> {
        if self.is_complete() {
            return self.link.write_all(buffer, priority).await;
        }
        self.before_message()?;
        self.step(self.link.write_all(buffer, priority)).await
    }

    async fn read(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<usize> {
        if self.is_complete() {
            return self.link.read(buffer, priority).await;
        }
        self.step(self.link.read(buffer, priority)).await
    }

    async fn read_exact(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<()> {
        if self.is_complete() {
            return self.link.read_exact(buffer, priority).await;
        }
        self.step(self.link.read_exact(buffer, priority)).await
    }

    async fn close(&self) -> ZResult<()> {
        self.link.close().await
    }

    #[cfg(all(feature = "uring", target_os = "linux"))]
    fn get_fd(&self) -> ZResult<std::os::fd::RawFd> {
        self.link.get_fd()
    }
}
