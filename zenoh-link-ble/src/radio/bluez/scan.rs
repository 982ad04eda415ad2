//! Owns scanning through bluetoothd: turns its device objects and their changes into fresh sightings.
use std::{
    collections::HashMap,
    time::{Duration, Instant},
};

use async_trait::async_trait;
use bluer::{Adapter, AdapterEvent, Address, DiscoveryFilter, DiscoveryTransport, Uuid};
use futures::{
    stream::{BoxStream, SelectAll},
    StreamExt,
};

use super::{device_address, errors::dbus_error, to_the_end};
use crate::{
    advertisement::{Advertisement, SERVICE_UUID},
    radio::{RadioError, Scan, Sighting},
};

/// Each look at a device is a D-Bus round trip; in a hall full of devices they add up.
const PER_DEVICE: Duration = Duration::from_millis(150);
/// Devices remembered for that.
const REMEMBERED: usize = 1024;
/// The controller reports an unchanged advertisement once per scan: a new scan hears everybody again.
const RESCAN: Duration = Duration::from_millis(600);

/// One run of bluetoothd's discovery. Dropping it stops the discovery, and the next one waits for that.
struct Discovery {
    adapter: Adapter,
    found: BoxStream<'static, AdapterEvent>,
    changed: SelectAll<BoxStream<'static, Address>>,
    started: Instant,
}

impl Discovery {
    async fn start(adapter: &Adapter) -> bluer::Result<Self> {
        let adapter = adapter.clone();
        to_the_end(async move {
            let found = adapter.discover_devices().await?.boxed();
            Ok(Self {
                adapter,
                found,
                changed: SelectAll::new(),
                started: Instant::now(),
            })
        })
        .await
    }

    /// The next device found or changed; `None` when bluetoothd ended the discovery.
    async fn next(&mut self) -> Option<Address> {
        loop {
            tokio::select! {
                event = self.found.next() => if let AdapterEvent::DeviceAdded(address) = event? {
                    self.watch(address).await;
                    return Some(address);
                },
                Some(address) = self.changed.next() => return Some(address),
            }
        }
    }

    async fn watch(&mut self, address: Address) {
        if let Ok(device) = self.adapter.device(address) {
            if let Ok(events) = device.events().await {
                self.changed.push(events.map(move |_| address).boxed());
            }
        }
    }
}

pub(super) struct BluezScan {
    adapter: Adapter,
    discovery: Option<Discovery>,
    looked_at: HashMap<Address, Instant>,
}

impl BluezScan {
    pub(super) async fn start(adapter: Adapter) -> bluer::Result<Self> {
        let filter = DiscoveryFilter {
            transport: DiscoveryTransport::Le,
            duplicate_data: true,
            ..Default::default()
        };
        // Another scan of this process may run with the same filter; it can't be set again then.
        if let Err(error) = adapter.set_discovery_filter(filter).await {
            tracing::debug!(%error, "the discovery filter stays as it is");
        }
        let discovery = Discovery::start(&adapter).await?;
        Ok(Self {
            adapter,
            discovery: Some(discovery),
            looked_at: HashMap::new(),
        })
    }

    /// The next device found or changed; starts the discovery anew when it is time to.
    async fn next_device(&mut self) -> Result<Address, RadioError> {
        loop {
            let discovery = match &mut self.discovery {
                Some(running) => running,
                stopped => {
                    let started = Discovery::start(&self.adapter).await;
                    stopped.insert(started.map_err(dbus_error("scan"))?)
                }
            };
            let left = RESCAN.saturating_sub(discovery.started.elapsed());
            match tokio::time::timeout(left, discovery.next()).await {
                Ok(Some(address)) => return Ok(address),
                Ok(None) => {
                    return Err(RadioError::NoService {
                        service: "bluetoothd",
                        advice: "it ended the scan; the scan starts again by itself".to_owned(),
                    })
                }
                Err(_) => self.discovery = None,
            }
        }
    }

    /// What bluetoothd knows of a device, if it was heard in this scan: a device remembered from earlier has no RSSI.
    async fn look_at(adapter: &Adapter, address: Address) -> Option<Sighting> {
        let device = adapter.device(address).ok()?;
        let (heard, data, kind) =
            tokio::join!(device.rssi(), device.service_data(), device.address_type());
        let rssi_dbm = heard.ok()??;
        let data = data.ok().flatten().unwrap_or_default();
        let advertisement = data
            .get(&Uuid::from_u128(SERVICE_UUID))
            .and_then(|data| Advertisement::decode(data).ok());
        Some(Sighting {
            device: device_address(address, kind.ok()?),
            advertisement,
            // 127 means "not known" (Core Specification, Vol 4, Part E, 7.7.65.2); heard it was all the same.
            rssi_dbm: Some(rssi_dbm).filter(|rssi| *rssi != 127),
        })
    }

    fn is_due(&self, address: Address) -> bool {
        let last = self.looked_at.get(&address);
        last.is_none_or(|last| last.elapsed() >= PER_DEVICE)
    }

    fn on_seen(&mut self, address: Address) {
        if self.looked_at.len() >= REMEMBERED {
            self.looked_at.clear();
        }
        self.looked_at.insert(address, Instant::now());
    }
}

#[async_trait]
impl Scan for BluezScan {
    async fn next(&mut self) -> Result<Sighting, RadioError> {
        loop {
            let address = self.next_device().await?;
            if self.is_due(address) {
                let adapter = self.adapter.clone();
                if let Some(sighting) = Self::look_at(&adapter, address).await {
                    self.on_seen(address);
                    return Ok(sighting);
                }
            }
        }
    }
}
