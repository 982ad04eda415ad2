//! Wraps an accepted link so that it holds a permit until Zenoh drops it, and so that its declarations wait if there are too many.

use std::{
    future::Future,
    sync::{
        atomic::{AtomicU8, Ordering},
        Arc,
    },
    time::Duration,
};

use async_trait::async_trait;
use tokio::{sync::Mutex, time::Instant};
use tokio_util::sync::CancellationToken;
use zenoh_link_commons::{LinkAuthId, LinkUnicast, LinkUnicastTrait, NewLink};
use zenoh_protocol::{
    core::{Locator, Priority},
    transport::BatchSize,
};
use zenoh_result::{bail, ZResult};

use super::{declarations::Incoming, Permit};

/// Number of messages that the accepting side sends in a handshake. Zenoh sends the second one, `OpenAck`, once the
/// peer has proved its login. (The second message may also be a refusal; the link is closed right after it.)
const HANDSHAKE_MESSAGES: u8 = 2;
/// Number of bytes that are read ahead at once.
const READ_BYTES: usize = 16 << 10;

/// An accepted link with its permit.
pub(super) struct AdmittedLink {
    link: Arc<dyn LinkUnicastTrait>,
    permit: Permit,
    /// Number of messages sent, up to [`HANDSHAKE_MESSAGES`].
    sent: AtomicU8,
    /// Cancelled when the handshake must end.
    handshake: CancellationToken,
    deadline: Instant,
    /// The stream that is read from the link; locked by its only reader.
    incoming: Mutex<Incoming>,
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
                incoming: Mutex::new(Incoming::new(now())),
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

    /// Waits until the next batch may be read.
    async fn wait_for_turn(
        &self,
        incoming: &mut Incoming,
        priority: Option<Priority>,
    ) -> ZResult<()> {
        let mut bytes = Vec::new();
        while let Some(until) = incoming.waits_until(now()) {
            bytes.resize(READ_BYTES, 0);
            let room = incoming.room().min(READ_BYTES);
            tokio::select! {
                () = tokio::time::sleep_until(until.into()) => {}
                read = self.link.read(&mut bytes[..room], priority), if room > 0 => match read? {
                    0 => bail!("the program has closed the link while its declarations waited"),
                    count => incoming.on_ahead(&bytes[..count]),
                },
            }
        }
        Ok(())
    }

    /// Reads from the link itself.
    async fn read_link(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<()> {
        if self.is_complete() {
            return self.link.read_exact(buffer, priority).await;
        }
        self.step(self.link.read_exact(buffer, priority)).await
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
        // Zenoh reads a link with priorities, or without a stream, in other ways.
        if self.supports_priorities() || !self.is_streamed() {
            return self.read_link(buffer, priority).await;
        }
        let mut incoming = self.incoming.lock().await;
        self.wait_for_turn(&mut incoming, priority).await?;
        let filled = incoming.fill(buffer);
        if filled < buffer.len() {
            self.read_link(&mut buffer[filled..], priority).await?;
        }
        if let Some(count) = incoming.on_part(buffer, now()) {
            self.permit.on_waited(self.get_dst(), count);
        }
        Ok(())
    }

    async fn close(&self) -> ZResult<()> {
        self.link.close().await
    }

    #[cfg(all(feature = "uring", target_os = "linux"))]
    fn get_fd(&self) -> ZResult<std::os::fd::RawFd> {
        self.link.get_fd()
    }
}

fn now() -> std::time::Instant {
    Instant::now().into_std()
}
