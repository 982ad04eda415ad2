//! Implements the objects that a simulated radio returns besides channels: advertisements, scans, listeners and pending
//! connects. Dropping one of them ends the operation on the air.
use std::sync::Arc;

use async_trait::async_trait;
use tokio::sync::mpsc;
use zenoh_link_ble_radio::{
    address::Psm, AdvertisingGuard, AdvertisingReport, Channel, ChannelListener, RadioError, Scan,
};

use super::{
    attachment::{Attachment, OpenListener},
    channel_handle::SimChannel,
    message::{Command, RequestId},
};

pub(super) struct SimAdvertisement {
    pub(super) attachment: Arc<Attachment>,
    pub(super) request: RequestId,
}

impl AdvertisingGuard for SimAdvertisement {}

impl Drop for SimAdvertisement {
    fn drop(&mut self) {
        let request = self.request;
        self.attachment
            .command(Command::StopAdvertising { request });
    }
}

pub(super) struct SimScan {
    pub(super) attachment: Arc<Attachment>,
    pub(super) request: RequestId,
    pub(super) reports: mpsc::Receiver<AdvertisingReport>,
}

#[async_trait]
impl Scan for SimScan {
    async fn next(&mut self) -> Result<AdvertisingReport, RadioError> {
        let report = self.reports.recv().await;
        report.ok_or_else(|| self.attachment.unavailable())
    }
}

impl Drop for SimScan {
    fn drop(&mut self) {
        self.attachment.end_scan(self.request);
    }
}

pub(super) struct SimListener(pub(super) OpenListener);

#[async_trait]
impl ChannelListener for SimListener {
    fn psm(&self) -> Psm {
        self.0.psm
    }

    async fn accept(&self) -> Result<Arc<dyn Channel>, RadioError> {
        match self.0.incoming.lock().await.recv().await {
            Some(channel) => Ok(Arc::new(SimChannel(channel))),
            None => Err(self.0.attachment.unavailable()),
        }
    }
}

/// Cancels a connect if its future is dropped before the response arrives.
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
