//! Implements [`Channel`] for the simulated air: backpressure, received SDUs, and the end of the channel.
use async_trait::async_trait;
use zenoh_link_ble_radio::{address::DeviceAddress, Channel, RadioError};

use super::{
    attachment::OpenChannel, channel_flow::Flow, message::Command,
    options::GUARANTEED_RECEIVE_BYTES,
};

/// One end of an open channel.
pub(super) struct SimChannel(pub(super) OpenChannel);

#[async_trait]
impl Channel for SimChannel {
    fn peer(&self) -> DeviceAddress {
        self.0.peer
    }

    fn adapter(&self) -> &str {
        &self.0.attachment.name
    }

    fn send_mtu(&self) -> usize {
        usize::from(self.0.limits.sdu_bytes)
    }

    fn is_central(&self) -> Option<bool> {
        Some(self.0.is_central)
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
        let mut flow = self.0.flow.inner.lock();
        if flow.is_down {
            return Err(self.down());
        }
        let has_room = self.0.limits.has_room(flow.queued_bytes);
        if has_room {
            flow.queued_bytes += sdu.len();
        }
        drop(flow);
        if has_room {
            self.0.attachment.command(Command::Send {
                channel: self.0.id,
                sdu: sdu.to_vec(),
            });
        }
        Ok(has_room)
    }

    async fn writable(&self) {
        let has_room = |flow: &mut Flow| {
            (flow.is_down || self.0.limits.has_room(flow.queued_bytes)).then_some(())
        };
        self.0.flow.wait(has_room).await;
    }

    async fn recv(&self, buffer: &mut [u8]) -> Result<usize, RadioError> {
        let (size, is_down) = self
            .0
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
            self.0
                .attachment
                .command(Command::SduRead { channel: self.0.id });
        }
        Ok(size)
    }

    fn shutdown(&self) {
        self.0.flow.close();
        self.0.attachment.end_channel(self.0.id, &self.0.flow);
    }
}

impl SimChannel {
    fn down(&self) -> RadioError {
        RadioError::ChannelDown {
            peer: self.0.peer,
            source: None,
        }
    }
}
