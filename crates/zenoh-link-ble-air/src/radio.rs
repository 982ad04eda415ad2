//! Implements [`Radio`] for the simulated air: [`SimRadio`] turns every operation into a command to the air.
use std::{future::Future, pin::Pin, sync::Arc};

use async_trait::async_trait;
use tokio::sync::{mpsc, oneshot};
use zenoh_link_ble_radio::{
    address::{DeviceAddress, Psm},
    advertisement::Advertisement,
    interval::ConnectionInterval,
    AdapterState, AdvertisingGuard, Channel, ChannelListener, ChannelOptions, Radio, RadioError,
    Scan,
};

use super::{
    attachment::{Attachment, PendingDial},
    channel_handle::SimChannel,
    guards::{CancelOnDrop, SimAdvertisement, SimListener, SimScan},
    message::{Command, ConnectFailure, ListenFailure},
    options::{MAX_NAME_BYTES, MIN_MTU},
};

/// Number of reports queued for a slow scan. Further reports are lost, as on a real radio.
const SCAN_QUEUE: usize = 256;

/// A simulated Bluetooth adapter.
pub struct SimRadio {
    pub(super) attachment: Arc<Attachment>,
}

#[async_trait]
impl Radio for SimRadio {
    fn name(&self) -> &str {
        &self.attachment.name
    }

    fn id(&self) -> String {
        // Several airs may have an adapter of that name.
        format!("{} at {:p}", self.name(), Arc::as_ptr(&self.attachment))
    }

    async fn address(&self) -> Result<DeviceAddress, RadioError> {
        self.attachment.wait_until_ready().await;
        match self.attachment.state() {
            AdapterState::Missing => Err(self.attachment.unavailable()),
            AdapterState::Off | AdapterState::On => Ok(self.attachment.address),
        }
    }

    async fn device_name(&self, device: DeviceAddress) -> Option<String> {
        self.attachment.device_name(device)
    }

    async fn state(&self) -> AdapterState {
        self.attachment.wait_until_ready().await;
        self.attachment.state()
    }

    // Not an `async fn`, so that changes are counted from the call and not from the first poll.
    fn changed<'life0, 'async_trait>(
        &'life0 self,
    ) -> Pin<Box<dyn Future<Output = ()> + Send + 'async_trait>>
    where
        'life0: 'async_trait,
        Self: 'async_trait,
    {
        let mut state = self.attachment.state.subscribe();
        Box::pin(async move {
            // The sender lives as long as this borrow of the radio.
            let _ = state.changed().await;
        })
    }

    async fn advertise(
        &self,
        advertisement: &Advertisement,
        name: &str,
    ) -> Result<Box<dyn AdvertisingGuard>, RadioError> {
        let attachment = &self.attachment;
        attachment.wait_until_ready().await;
        let request = attachment.registrations_if_on()?.next_request();
        attachment.command(Command::Advertise {
            request,
            advertisement: *advertisement,
            name: truncate_name(name).to_owned(),
        });
        Ok(Box::new(SimAdvertisement {
            attachment: Arc::clone(attachment),
            request,
        }))
    }

    async fn scan(&self) -> Result<Box<dyn Scan>, RadioError> {
        let attachment = &self.attachment;
        attachment.wait_until_ready().await;
        let (sender, reports) = mpsc::channel(SCAN_QUEUE);
        let request = {
            let mut registrations = attachment.registrations_if_on()?;
            let request = registrations.next_request();
            registrations.scans.insert(request, sender);
            request
        };
        attachment.command(Command::Scan(true));
        Ok(Box::new(SimScan {
            attachment: Arc::clone(attachment),
            request,
            reports,
        }))
    }

    fn default_interval(&self) -> ConnectionInterval {
        self.attachment.default_interval()
    }

    fn changes_open_connections(&self) -> bool {
        self.attachment.changes_open_connections()
    }

    async fn set_interval(&self, peer: DeviceAddress, interval: ConnectionInterval) -> bool {
        let units = interval.units();
        let command = Command::SetInterval { peer, units };
        self.attachment.command(command);
        true
    }

    async fn disconnect(&self, peer: DeviceAddress) {
        self.attachment.command(Command::Disconnect { peer });
    }

    async fn listen(
        &self,
        psm: Option<Psm>,
        options: ChannelOptions,
    ) -> Result<Box<dyn ChannelListener>, RadioError> {
        let attachment = &self.attachment;
        attachment.wait_until_ready().await;
        let (sender, answer) = oneshot::channel();
        let request = {
            let mut registrations = attachment.registrations_if_on()?;
            let request = registrations.next_request();
            registrations.listening.insert(request, sender);
            request
        };
        attachment.command(Command::Listen {
            request,
            psm,
            recv_mtu: options.recv_mtu.max(MIN_MTU),
        });
        match answer.await {
            Ok(Ok(listener)) => Ok(Box::new(SimListener(listener))),
            Ok(Err(ListenFailure::Taken)) => match psm {
                Some(psm) => Err(RadioError::PsmTaken(psm)),
                None => Err(attachment.unavailable()),
            },
            Ok(Err(ListenFailure::NoneFree)) => Err(RadioError::System {
                action: "choose a psm",
                source: "all 128 PSMs of this adapter are in use".into(),
            }),
            Ok(Err(ListenFailure::Unavailable)) | Err(_) => Err(attachment.unavailable()),
        }
    }

    async fn connect(
        &self,
        peer: DeviceAddress,
        psm: Psm,
        options: ChannelOptions,
    ) -> Result<Arc<dyn Channel>, RadioError> {
        let attachment = &self.attachment;
        attachment.wait_until_ready().await;
        let (sender, answer) = oneshot::channel();
        let request = {
            let mut registrations = attachment.registrations_if_on()?;
            let request = registrations.next_request();
            let dial = PendingDial {
                peer,
                answer: sender,
            };
            registrations.dials.insert(request, dial);
            request
        };
        attachment.command(Command::Connect {
            request,
            peer,
            psm,
            recv_mtu: options.recv_mtu.max(MIN_MTU),
        });
        let mut cancel = CancelOnDrop::new(Arc::clone(attachment), request);
        let answered = answer.await;
        cancel.disarm();
        match answered {
            Ok(Ok(channel)) => Ok(Arc::new(SimChannel(channel))),
            Ok(Err(ConnectFailure::Refused)) => Err(RadioError::Refused { peer, psm }),
            Ok(Err(ConnectFailure::LinkLost)) => Err(RadioError::ChannelDown {
                peer,
                source: Some(std::io::ErrorKind::ConnectionAborted.into()),
            }),
            Ok(Err(ConnectFailure::Unavailable)) | Err(_) => Err(attachment.unavailable()),
        }
    }
}

/// Returns the name, truncated to the space in the scan response.
fn truncate_name(name: &str) -> &str {
    let mut end = name.len().min(MAX_NAME_BYTES);
    while !name.is_char_boundary(end) {
        end -= 1;
    }
    &name[..end]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn truncates_long_names_at_a_character_boundary() {
        assert_eq!(truncate_name("wombat-1"), "wombat-1");
        let long = "ä".repeat(20);
        assert_eq!(truncate_name(&long), "ä".repeat(14));
    }
}
