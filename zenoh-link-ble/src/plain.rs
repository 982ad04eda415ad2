//! Owns the batches of a plain peer (a microcontroller without hello): one bare batch per SDU, as they come.
use std::sync::Arc;

use tokio::sync::Mutex;
use tokio_util::sync::CancellationToken;

use crate::{
    error::BleError,
    lanes::report::Count,
    radio::Channel,
    traffic::{takes_nothing, SEND_TIMEOUT},
};

pub(crate) struct Plain {
    channel: Arc<dyn Channel>,
    mtu: usize,
    receive: Mutex<Receive>,
    replaced: CancellationToken,
    counts: parking_lot::Mutex<(Count, Count)>,
}

struct Receive {
    sdu: Vec<u8>,
    /// A batch that came before the link was made.
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
                // One byte more than is allowed, so that a larger SDU shows instead of being cut.
                sdu: vec![0; mtu + 1],
                first,
            }),
            replaced,
            counts: parking_lot::Mutex::default(),
        }
    }

    /// What was sent and received.
    pub(crate) fn counts(&self) -> (Count, Count) {
        *self.counts.lock()
    }

    pub(crate) async fn write(&self, batch: &[u8]) -> Result<(), BleError> {
        if batch.is_empty() {
            // Zenoh does this when it abandons a fragmented message; an empty SDU would end the channel.
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
                Err(_) => Err(takes_nothing()),
            },
            () = self.replaced.cancelled() => Err(self.replaced()),
        }
    }

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
