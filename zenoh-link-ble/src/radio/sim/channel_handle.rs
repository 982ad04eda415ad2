//! Implements [`Channel`] for the simulated air: backpressure, received SDUs, and the end of the channel.
use std::{collections::VecDeque, sync::Arc};

use async_trait::async_trait;
use parking_lot::Mutex;
use tokio::sync::Notify;

use super::{
    attachment::Attachment,
    message::{ChannelId, Command, SendLimits},
    options::GUARANTEED_RECEIVE_BYTES,
};
use crate::{
    address::DeviceAddress,
    radio::{Channel, RadioError},
};

/// One end of an open channel.
pub(super) struct SimChannel {
    attachment: Arc<Attachment>,
    id: ChannelId,
    peer: DeviceAddress,
    limits: SendLimits,
    flow: Arc<ChannelFlow>,
}

/// State of a channel as reported by the air, and a wake-up for the tasks that wait for a change.
#[derive(Default)]
pub(super) struct ChannelFlow {
    inner: Mutex<Flow>,
    changed: Notify,
}

#[derive(Default)]
struct Flow {
    queued_bytes: usize,
    unread: VecDeque<Vec<u8>>,
    is_down: bool,
}

#[async_trait]
impl Channel for SimChannel {
    fn peer(&self) -> DeviceAddress {
        self.peer
    }

    fn adapter(&self) -> &str {
        &self.attachment.name
    }

    fn send_mtu(&self) -> usize {
        usize::from(self.limits.sdu_bytes)
    }

    fn receive_capacity_bytes(&self) -> usize {
        GUARANTEED_RECEIVE_BYTES
    }

    fn try_send(&self, sdu: &[u8]) -> Result<bool, RadioError> {
        if sdu.is_empty() || sdu.len() > self.send_mtu() {
            return Err(RadioError::SduTooLarge {
                size: sdu.len(),
                limit: self.send_mtu(),
            });
        }
        let mut flow = self.flow.inner.lock();
        if flow.is_down {
            return Err(self.down());
        }
        let has_room = self.limits.has_room(flow.queued_bytes);
        if has_room {
            flow.queued_bytes += sdu.len();
        }
        drop(flow);
        if has_room {
            self.attachment.command(Command::Send {
                channel: self.id,
                sdu: sdu.to_vec(),
            });
        }
        Ok(has_room)
    }

    async fn writable(&self) {
        let has_room = |flow: &mut Flow| {
            (flow.is_down || self.limits.has_room(flow.queued_bytes)).then_some(())
        };
        self.flow.wait(has_room).await;
    }

    async fn recv(&self, buffer: &mut [u8]) -> Result<usize, RadioError> {
        let (size, is_down) = self
            .flow
            .wait(|flow| {
                // SDUs that arrived before the end can still be read.
                match flow.unread.front() {
                    Some(sdu) if sdu.len() > buffer.len() => Some(Err(RadioError::SduTooLarge {
                        size: sdu.len(),
                        limit: buffer.len(),
                    })),
                    Some(_) => flow.unread.pop_front().map(|sdu| {
                        buffer[..sdu.len()].copy_from_slice(&sdu);
                        Ok((sdu.len(), flow.is_down))
                    }),
                    None if flow.is_down => Some(Err(self.down())),
                    None => None,
                }
            })
            .await?;
        if !is_down {
            self.attachment
                .command(Command::SduRead { channel: self.id });
        }
        Ok(size)
    }

    fn shutdown(&self) {
        self.flow.close();
        self.attachment.end_channel(self.id, &self.flow);
    }
}

impl Drop for SimChannel {
    fn drop(&mut self) {
        self.attachment.end_channel(self.id, &self.flow);
    }
}

impl SimChannel {
    pub(super) fn new(
        attachment: Arc<Attachment>,
        id: ChannelId,
        peer: DeviceAddress,
        limits: SendLimits,
        flow: Arc<ChannelFlow>,
    ) -> Self {
        Self {
            attachment,
            id,
            peer,
            limits,
            flow,
        }
    }

    fn down(&self) -> RadioError {
        RadioError::ChannelDown {
            peer: self.peer,
            source: None,
        }
    }
}

impl ChannelFlow {
    /// Handles that `bytes` of the oldest queued SDU have arrived at the peer.
    pub(super) fn on_sent(&self, bytes: usize) {
        let mut flow = self.inner.lock();
        flow.queued_bytes = flow.queued_bytes.saturating_sub(bytes);
        drop(flow);
        self.changed.notify_waiters();
    }

    /// Handles a received SDU.
    pub(super) fn on_received(&self, sdu: Vec<u8>) {
        let mut flow = self.inner.lock();
        if !flow.is_down {
            flow.unread.push_back(sdu);
        }
        drop(flow);
        self.changed.notify_waiters();
    }

    /// Marks the channel as down. SDUs that arrived before can still be read.
    pub(super) fn on_closed(&self) {
        self.inner.lock().is_down = true;
        self.changed.notify_waiters();
    }

    /// Closes this end and discards unread SDUs.
    fn close(&self) {
        let mut flow = self.inner.lock();
        flow.is_down = true;
        flow.unread.clear();
        drop(flow);
        self.changed.notify_waiters();
    }

    /// Waits until `condition` returns a value. Cancel-safe: `condition` has either returned its value or changed
    /// nothing.
    async fn wait<T>(&self, mut condition: impl FnMut(&mut Flow) -> Option<T>) -> T {
        loop {
            // Registered before the check, so that a change in between is not missed.
            let changed = self.changed.notified();
            tokio::pin!(changed);
            changed.as_mut().enable();
            if let Some(found) = condition(&mut self.inner.lock()) {
                return found;
            }
            changed.await;
        }
    }
}
