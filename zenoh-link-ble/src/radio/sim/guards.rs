//! Owns what a simulated radio hands out beside channels: an advertisement, a scan, a listener, a pending connect. Each
//! takes itself off the air when it is dropped.
use std::sync::Arc;

use async_trait::async_trait;
use tokio::sync::{mpsc, Mutex};

use super::{
    attachment::Attachment,
    channel_handle::SimChannel,
    message::{Command, RequestId},
};
use crate::{
    address::Psm,
    radio::{AdvertisingGuard, Channel, ChannelListener, RadioError, Scan, Sighting},
};

pub(super) struct Advertised {
    pub(super) attachment: Arc<Attachment>,
    pub(super) request: RequestId,
}

impl AdvertisingGuard for Advertised {}

impl Drop for Advertised {
    fn drop(&mut self) {
        let request = self.request;
        self.attachment
            .command(Command::StopAdvertising { request });
    }
}

pub(super) struct SimScan {
    pub(super) attachment: Arc<Attachment>,
    pub(super) request: RequestId,
    pub(super) heard: mpsc::Receiver<Sighting>,
}

#[async_trait]
impl Scan for SimScan {
    async fn next(&mut self) -> Result<Sighting, RadioError> {
        let heard = self.heard.recv().await;
        heard.ok_or_else(|| self.attachment.unavailable())
    }
}

impl Drop for SimScan {
    fn drop(&mut self) {
        self.attachment.end_scan(self.request);
    }
}

pub(super) struct SimListener {
    attachment: Arc<Attachment>,
    request: RequestId,
    psm: Psm,
    calls: Mutex<mpsc::UnboundedReceiver<SimChannel>>,
}

impl SimListener {
    pub(super) fn new(
        attachment: Arc<Attachment>,
        request: RequestId,
        psm: Psm,
        calls: mpsc::UnboundedReceiver<SimChannel>,
    ) -> Self {
        Self {
            attachment,
            request,
            psm,
            calls: Mutex::new(calls),
        }
    }
}

#[async_trait]
impl ChannelListener for SimListener {
    fn psm(&self) -> Psm {
        self.psm
    }

    async fn accept(&self) -> Result<Arc<dyn Channel>, RadioError> {
        match self.calls.lock().await.recv().await {
            Some(channel) => Ok(Arc::new(channel)),
            None => Err(self.attachment.unavailable()),
        }
    }
}

impl Drop for SimListener {
    fn drop(&mut self) {
        self.attachment.end_listener(self.request, self.psm);
    }
}

/// Takes a connect back when its future is dropped before it is answered.
pub(super) struct CancelOnDrop {
    attachment: Arc<Attachment>,
    request: Option<RequestId>,
}

impl CancelOnDrop {
    pub(super) fn new(attachment: Arc<Attachment>, request: RequestId) -> Self {
        Self {
            attachment,
            request: Some(request),
        }
    }

    pub(super) fn disarm(&mut self) {
        self.request = None;
    }
}

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        if let Some(request) = self.request {
            self.attachment.end_dial(request);
        }
    }
}
