//! Scans through bluetoothd: turns its device objects and their property changes into advertising reports.
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
use zenoh_link_ble_radio::{
    advertisement::{Advertisement, SERVICE_UUID},
    AdvertisingReport, RadioError, Scan,
};

use super::{device_address, errors::dbus_error, run_to_completion};

/// Minimum time between two reads of one device. Each read is a D-Bus round trip, which adds up if many devices are in
/// range.
const MIN_READ_INTERVAL: Duration = Duration::from_millis(150);
/// Maximum number of devices for which the time of the last read is kept.
const MAX_DEVICES: usize = 1024;
/// Time after which the discovery is restarted. The controller reports an unchanged advertisement once per scan; a new
/// scan reports every device again.
const RESCAN_INTERVAL: Duration = Duration::from_millis(600);

/// One run of bluetoothd's discovery. Dropping it stops the discovery; the next run waits until it has stopped.
struct Discovery {
    adapter: Adapter,
    found: BoxStream<'static, AdapterEvent>,
    changed: SelectAll<BoxStream<'static, Address>>,
    started: Instant,
}

impl Discovery {
    async fn start(adapter: &Adapter) -> bluer::Result<Self> {
        let adapter = adapter.clone();
        run_to_completion(async move {
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

    /// Returns the next device that was found or changed; `None` if bluetoothd ended the discovery.
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
    last_read: HashMap<Address, Instant>,
}

impl BluezScan {
    pub(super) async fn start(adapter: Adapter) -> bluer::Result<Self> {
        let filter = DiscoveryFilter {
            transport: DiscoveryTransport::Le,
            duplicate_data: true,
            ..Default::default()
        };
        // Another scan of this process may be running with the same filter, which cannot be set again then.
        if let Err(error) = adapter.set_discovery_filter(filter).await {
            tracing::debug!(%error, "the discovery filter could not be set");
        }
        let discovery = Discovery::start(&adapter).await?;
        Ok(Self {
            adapter,
            discovery: Some(discovery),
            last_read: HashMap::new(),
        })
    }

    /// Returns the next device that was found or changed. Restarts the discovery when it is due.
    async fn next_device(&mut self) -> Result<Address, RadioError> {
        loop {
            let discovery = match &mut self.discovery {
                Some(running) => running,
                stopped => {
                    let started = Discovery::start(&self.adapter).await;
                    stopped.insert(started.map_err(dbus_error("scan"))?)
                }
            };
            let remaining = RESCAN_INTERVAL.saturating_sub(discovery.started.elapsed());
            match tokio::time::timeout(remaining, discovery.next()).await {
                Ok(Some(address)) => return Ok(address),
                Ok(None) => {
                    return Err(RadioError::NoService {
                        service: "bluetoothd",
                        advice: "it ended the scan, which is restarted automatically".to_owned(),
                    })
                }
                Err(_) => self.discovery = None,
            }
        }
    }

    /// Reads the properties of a device if it was received in this scan: a device remembered from earlier has no RSSI.
    async fn read_device(adapter: &Adapter, address: Address) -> Option<AdvertisingReport> {
        let device = adapter.device(address).ok()?;
        let (rssi, data, kind) =
            tokio::join!(device.rssi(), device.service_data(), device.address_type());
        let rssi_dbm = rssi.ok()??;
        let data = data.ok().flatten().unwrap_or_default();
        let advertisement = data
            .get(&Uuid::from_u128(SERVICE_UUID))
            .and_then(|data| Advertisement::decode(data).ok());
        Some(AdvertisingReport {
            device: device_address(address, kind.ok()?),
            advertisement,
            // 127 means "not available" (Core Specification, Vol 4, Part E, 7.7.65.2); the advertisement was still
            // received.
            rssi_dbm: Some(rssi_dbm).filter(|rssi| *rssi != 127),
        })
    }

    fn is_due(&self, address: Address) -> bool {
        let last = self.last_read.get(&address);
        last.is_none_or(|last| last.elapsed() >= MIN_READ_INTERVAL)
    }

    fn on_read(&mut self, address: Address) {
        if self.last_read.len() >= MAX_DEVICES {
            self.last_read.clear();
        }
        self.last_read.insert(address, Instant::now());
    }
}

#[async_trait]
impl Scan for BluezScan {
    async fn next(&mut self) -> Result<AdvertisingReport, RadioError> {
        loop {
            let address = self.next_device().await?;
            if self.is_due(address) {
                let adapter = self.adapter.clone();
                if let Some(report) = Self::read_device(&adapter, address).await {
                    self.on_read(address);
                    return Ok(report);
                }
            }
        }
    }
}
