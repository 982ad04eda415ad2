//! Implements [`Radio`] with the Bluetooth stack of Linux: bluetoothd over D-Bus for adapters, advertising and
//! scanning, and kernel sockets for channels. Only this crate uses the crate `bluer`.
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used))]
mod adapters;
mod channel;
mod errors;
mod identity;
pub mod management;
mod pairing;
mod peer_intervals;
mod role;
mod scan;
mod scan_recovery;
mod sdu_socket;
mod socket;
mod timing;
mod watch;

use std::{
    future::Future,
    io,
    sync::{Arc, OnceLock},
};

use async_trait::async_trait;
use bluer::{adv, Adapter, Session, Uuid};
use tokio::sync::OnceCell;
use zenoh_link_ble_radio::{
    address::{Address, AddressType, DeviceAddress, Psm},
    advertisement::{Advertisement, SERVICE_UUID},
    interval::ConnectionInterval,
    AdapterState, AdvertisingGuard, Channel, ChannelListener, ChannelOptions, Radio, RadioError,
    Scan,
};

use self::{
    channel::{BluezChannel, BluezListener},
    errors::{dbus_error, no_adapter},
    identity::Identity,
    pairing::Pairing,
    peer_intervals::PeerIntervals,
    scan::BluezScan,
    scan_recovery::ScanRecovery,
    timing::Timing,
    watch::Watch,
};

pub use self::{adapters::adapters, timing::is_configured_externally as is_timing_configured};

/// Adapter that is used if none is named.
const DEFAULT_ADAPTER: &str = "hci0";
/// Minimum and maximum advertising interval. With BlueZ's default of 1.28 s, finding a robot would take seconds.
/// bluetoothd accepts this value from programs only if it runs with `--experimental`; `config/bluetooth.conf` sets the
/// same value for all programs.
const ADVERTISING_INTERVAL: (std::time::Duration, std::time::Duration) = (
    std::time::Duration::from_millis(100),
    std::time::Duration::from_millis(150),
);

/// How long bluetoothd transmits one advertisement before it switches to the next one. After a link ends, Linux 5.10
/// advertises again only when this time has elapsed. The default is 2 s, and bluetoothd accepts whole seconds only.
const ADVERTISING_TURN: std::time::Duration = std::time::Duration::from_secs(1);

/// Returns the adapter of that name, or `hci0` if `name` is `None`. Does not access the system before the radio is
/// used.
pub fn radio(name: Option<&str>) -> Result<Arc<dyn Radio>, RadioError> {
    Ok(Arc::new(BluezRadio {
        identity: Arc::new(Identity::new(name.unwrap_or(DEFAULT_ADAPTER))),
        timing: Timing::default(),
        session: OnceCell::new(),
        watch: OnceCell::new(),
        pairing: Pairing::default(),
        peer_intervals: PeerIntervals::default(),
        preferred_interval: OnceLock::new(),
        scan_recovery: ScanRecovery::default(),
    }))
}

struct BluezRadio {
    identity: Arc<Identity>,
    timing: Timing,
    session: OnceCell<Session>,
    watch: OnceCell<Watch>,
    pairing: Pairing,
    peer_intervals: PeerIntervals,
    preferred_interval: OnceLock<ConnectionInterval>,
    scan_recovery: ScanRecovery,
}

impl BluezRadio {
    async fn session(&self) -> Result<&Session, RadioError> {
        self.session
            .get_or_try_init(|| async {
                Session::new().await.map_err(dbus_error("reach bluetoothd"))
            })
            .await
    }

    /// Returns the adapter after checking that it exists and is powered on.
    async fn adapter(&self) -> Result<Adapter, RadioError> {
        let session = self.session().await?;
        let found = async {
            let adapter = self.identity.find(session).await?;
            let is_powered = adapter.is_powered().await?;
            Ok((adapter, is_powered))
        };
        match found.await {
            Ok((adapter, true)) => Ok(adapter),
            Ok((adapter, false)) => Err(RadioError::AdapterOff {
                adapter: adapter.name().to_owned(),
            }),
            Err(error) => match dbus_error("use the adapter")(error) {
                error @ (RadioError::NoService { .. } | RadioError::NotPermitted { .. }) => {
                    Err(error)
                }
                _ => Err(no_adapter(&self.identity.name(), session).await),
            },
        }
    }

    /// Returns the adapter after preparing it for channels with these options.
    async fn adapter_for(&self, options: &ChannelOptions) -> Result<Adapter, RadioError> {
        let adapter = self.adapter().await?;
        self.timing.apply(adapter.name());
        let (session, epoch) = (self.session().await?, self.epoch());
        let pairing = &self.pairing;
        (pairing.prepare(session, adapter.name(), epoch, options)).await?;
        Ok(adapter)
    }
}

#[async_trait]
impl Radio for BluezRadio {
    fn name(&self) -> &str {
        self.identity.requested_name()
    }

    fn id(&self) -> String {
        self.name().to_owned()
    }

    async fn address(&self) -> Result<DeviceAddress, RadioError> {
        own_address(&self.adapter().await?).await
    }

    async fn state(&self) -> AdapterState {
        match self.adapter().await {
            Ok(_) => AdapterState::On,
            Err(RadioError::AdapterOff { .. }) => AdapterState::Off,
            Err(_) => AdapterState::Missing,
        }
    }

    async fn changed(&self) {
        let watch = self
            .watch
            .get_or_try_init(|| async {
                let session = self.session().await?;
                Watch::start(session.clone(), Arc::clone(&self.identity)).await
            })
            .await;
        match watch {
            Ok(watch) => watch.changed().await,
            // Without a watch, changes cannot be detected. The caller polls the state itself.
            Err(_) => std::future::pending().await,
        }
    }

    fn epoch(&self) -> u64 {
        self.watch.get().map_or(0, Watch::epoch) + self.identity.renames()
    }

    async fn advertise(
        &self,
        advertisement: &Advertisement,
        name: &str,
    ) -> Result<Box<dyn AdvertisingGuard>, RadioError> {
        let adapter = self.adapter().await?;
        // Linux 5.10 scans with a random address, which it cannot set while it advertises. If the adapter advertised
        // first, every later scan would be refused. One scan before advertising sets the address; if it fails, the
        // advertisement fails too.
        let _first_scan = BluezScan::start(adapter.clone()).await;
        let data = advertisement.encode().to_vec();
        let advertisement = adv::Advertisement {
            advertisement_type: adv::Type::Peripheral,
            service_data: [(Uuid::from_u128(SERVICE_UUID), data)].into(),
            discoverable: Some(true),
            local_name: Some(name.to_owned()),
            min_interval: Some(ADVERTISING_INTERVAL.0),
            max_interval: Some(ADVERTISING_INTERVAL.1),
            duration: Some(ADVERTISING_TURN),
            ..Default::default()
        };
        let handle = run_to_completion(async move { adapter.advertise(advertisement).await })
            .await
            .map_err(dbus_error("advertise"))?;
        Ok(Box::new(BluezAdvertising { _handle: handle }))
    }

    async fn scan(&self) -> Result<Box<dyn Scan>, RadioError> {
        let adapter = self.adapter().await?;
        match BluezScan::start(adapter.clone()).await {
            Ok(scan) => {
                self.scan_recovery.on_started();
                Ok(Box::new(scan))
            }
            Err(error) => {
                self.scan_recovery.on_failed(&adapter, &error).await;
                Err(dbus_error("scan")(error))
            }
        }
    }

    async fn device_name(&self, device: DeviceAddress) -> Option<String> {
        let device = self
            .adapter()
            .await
            .ok()?
            .device(bluer::Address(device.address.0));
        device.ok()?.name().await.ok()?
    }

    async fn listen(
        &self,
        psm: Option<Psm>,
        options: ChannelOptions,
    ) -> Result<Box<dyn ChannelListener>, RadioError> {
        let adapter = self.adapter_for(&options).await?;
        let own = own_address(&adapter).await?;
        let listener = BluezListener::start(adapter.name(), own, psm, options)?;
        Ok(Box::new(listener))
    }

    async fn connect(
        &self,
        peer: DeviceAddress,
        psm: Psm,
        options: ChannelOptions,
    ) -> Result<Arc<dyn Channel>, RadioError> {
        let adapter = self.adapter_for(&options).await?;
        let own = own_address(&adapter).await?;
        let channel = BluezChannel::connect(adapter.name(), own, peer, psm, options).await?;
        Ok(Arc::new(channel))
    }

    fn default_interval(&self) -> ConnectionInterval {
        *self
            .preferred_interval
            .get_or_init(timing::preferred_interval)
    }

    fn changes_open_connections(&self) -> bool {
        peer_intervals::changes_open_connections()
    }

    async fn set_interval(&self, peer: DeviceAddress, interval: ConnectionInterval) -> bool {
        let adapter = self.identity.name();
        self.peer_intervals.set(&adapter, peer, interval).await
    }

    async fn disconnect(&self, peer: DeviceAddress) {
        // bluetoothd keeps the connection open through its own channels, and the kernel would continue with stale
        // channel state ("Source CID already allocated").
        let adapter = self.identity.name();
        let Some(is_central) = role::is_central(&adapter, peer) else {
            return;
        };
        let name = adapter.clone();
        let closed = tokio::task::spawn_blocking(move || management::disconnect(&name, peer)).await;
        match closed {
            Ok(Err(error)) if error.kind() == io::ErrorKind::PermissionDenied => {}
            _ => return,
        }
        // bluetoothd closes a connection two seconds after it is asked to. The peer does not know that, and may open a channel
        // meanwhile, so this is left to the central, which waits before it dials again.
        if is_central {
            self.disconnect_by_bluetoothd(peer).await;
        }
    }
}

impl BluezRadio {
    async fn disconnect_by_bluetoothd(&self, peer: DeviceAddress) {
        let Ok(adapter) = self.adapter().await else {
            return;
        };
        if let Ok(device) = adapter.device(bluer::Address(peer.address.0)) {
            if let Err(error) = device.disconnect().await {
                tracing::debug!(%peer, %error, "the connection could not be closed");
            }
        }
    }
}

/// Runs `operation` to completion even if the caller drops the future. If a bluer call is dropped halfway, bluer loses
/// track of the request: bluetoothd then scans or advertises for this process permanently, and refuses to start a scan
/// that is already running.
async fn run_to_completion<T: Send + 'static>(
    operation: impl Future<Output = T> + Send + 'static,
) -> T {
    match tokio::spawn(operation).await {
        Ok(answer) => answer,
        Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
        // The runtime is shutting down, and this future with it.
        Err(_) => std::future::pending().await,
    }
}

struct BluezAdvertising {
    _handle: adv::AdvertisementHandle,
}

impl AdvertisingGuard for BluezAdvertising {}

async fn own_address(adapter: &Adapter) -> Result<DeviceAddress, RadioError> {
    let address = adapter
        .address()
        .await
        .map_err(dbus_error("read the adapter's address"))?;
    let kind = adapter
        .address_type()
        .await
        .map_err(dbus_error("read the adapter's address"))?;
    Ok(device_address(address, kind))
}

fn device_address(address: bluer::Address, kind: bluer::AddressType) -> DeviceAddress {
    DeviceAddress {
        address: Address(address.0),
        kind: match kind {
            bluer::AddressType::LeRandom => AddressType::Random,
            _ => AddressType::Public,
        },
    }
}
