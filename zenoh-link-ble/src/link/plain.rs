//! Sends and receives the batches of a link with a plain peer (a microcontroller without a hello): one bare batch per SDU,
//! without lanes.
use std::sync::Arc;

use link_lanes::lanes::report::Count;
use tokio::sync::Mutex;
use tokio_util::sync::CancellationToken;
use zenoh_link_ble_radio::Channel;

use crate::{
    error::BleError,
    link::traffic::{send_timed_out, SEND_TIMEOUT},
};

/// The batches of a link with a plain peer.
pub(crate) struct Plain {
    channel: Arc<dyn Channel>,
    mtu: usize,
    receive: Mutex<Receive>,
    replaced: CancellationToken,
    counts: parking_lot::Mutex<(Count, Count)>,
}

struct Receive {
    sdu: Vec<u8>,
    /// A batch that was received before the link was opened.
    first: Option<Vec<u8>>,
}

impl Plain {
    pub(crate) fn new(
        channel: Arc<dyn Channel>,
        mtu: u16,
        first: Option<Vec<u8>>,
        replaced: CancellationToken,
    ) -> Self {
        let mtu = usize::from(mtu);
        Self {
            channel,
            mtu,
            receive: Mutex::new(Receive {
                // One byte more than is allowed, so that a larger SDU is detected instead of being truncated.
                sdu: vec![0; mtu + 1],
                first,
            }),
            replaced,
            counts: parking_lot::Mutex::default(),
        }
    }

    /// Returns the counts of sent and of received batches.
    pub(crate) fn counts(&self) -> (Count, Count) {
        *self.counts.lock()
    }

    /// Sends a batch.
    ///
    /// # Errors
    /// Fails if the batch is larger than the MTU, if the peer accepts nothing within [`SEND_TIMEOUT`], or if the link has
    /// ended.
    pub(crate) async fn write(&self, batch: &[u8]) -> Result<(), BleError> {
        if batch.is_empty() {
            // Zenoh writes an empty batch when it abandons a fragmented message. An empty SDU would end the channel.
            return Ok(());
        }
        if batch.len() > self.mtu {
            return Err(BleError::BatchTooLarge {
                size: batch.len(),
                mtu: self.mtu,
            });
        }
        let sending = tokio::time::timeout(SEND_TIMEOUT, self.channel.send(batch));
        tokio::select! {
            sent = sending => match sent {
                Ok(sent) => {
                    sent?;
                    self.counts.lock().0.count(batch.len());
                    Ok(())
                }
                Err(_) => Err(send_timed_out()),
            },
            () = self.replaced.cancelled() => Err(self.replaced()),
        }
    }

    /// Receives the next batch.
    ///
    /// # Errors
    /// Fails if the link has ended, or if the batch is larger than the MTU.
    pub(crate) async fn read(&self) -> Result<Vec<u8>, BleError> {
        let batch = self.receive().await?;
        self.counts.lock().1.count(batch.len());
        Ok(batch)
    }

    async fn receive(&self) -> Result<Vec<u8>, BleError> {
        let mut receive = self.receive.lock().await;
        if let Some(first) = receive.first.take() {
            return Ok(first);
        }
        let size = tokio::select! {
            size = self.channel.recv(&mut receive.sdu) => size?,
            () = self.replaced.cancelled() => return Err(self.replaced()),
        };
        if size > self.mtu {
            return Err(BleError::Protocol {
                peer: self.channel.peer(),
                what: format!("a batch of {size} bytes is over the mtu of {}", self.mtu),
            });
        }
        Ok(receive.sdu.get(..size).unwrap_or_default().to_vec())
    }

    fn replaced(&self) -> BleError {
        BleError::Replaced {
            peer: self.channel.peer().to_string(),
        }
    }
}
