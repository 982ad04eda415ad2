//! Owns Linux's own Bluetooth stack as a [`Radio`]: bluetoothd over D-Bus for adapters, advertising and scanning,
//! kernel sockets for channels. This file and its folder are the only ones that name `bluer`.
mod channel;
mod errors;
mod identity;
mod packets;
mod pairing;
mod scan;
mod socket;
mod stuck;
mod timing;
mod watch;

use std::{future::Future, sync::Arc};

use async_trait::async_trait;
use bluer::{adv, Adapter, Session, Uuid};
use tokio::sync::OnceCell;

use self::{
    channel::{BluezChannel, BluezListener},
    errors::{dbus_error, no_adapter},
    identity::Identity,
    pairing::Pairing,
    scan::BluezScan,
    stuck::Refusals,
    timing::Timing,
    watch::Watch,
};
use super::{
    AdapterState, AdvertisingGuard, Channel, ChannelListener, ChannelOptions, Radio, RadioError,
    Scan,
};
use crate::{
    address::{Address, AddressType, DeviceAddress, Psm},
    advertisement::{Advertisement, SERVICE_UUID},
};

pub use self::timing::is_seen_to as timing_is_seen_to;

/// The adapter taken when none is named.
const DEFAULT_ADAPTER: &str = "hci0";
/// How often to advertise. BlueZ's default of 1.28 s would make finding a robot take seconds. bluetoothd takes this from
/// programs only if it runs with `--experimental`; `config/bluetooth.conf` says the same for all of them.
const ADVERTISING_INTERVAL: (std::time::Duration, std::time::Duration) = (
    std::time::Duration::from_millis(100),
    std::time::Duration::from_millis(150),
);

/// How long a turn among several advertisements takes. Linux 5.10 advertises again after a link's end only when the turn
/// is over, which by default takes 2 s; bluetoothd counts in seconds.
const ADVERTISING_TURN: std::time::Duration = std::time::Duration::from_secs(1);

/// The adapter of that name; left out, `hci0`. Nothing is asked of the system before the radio is used.
pub fn radio(name: Option<&str>) -> Result<Arc<dyn Radio>, RadioError> {
    Ok(Arc::new(BluezRadio {
        identity: Arc::new(Identity::new(name.unwrap_or(DEFAULT_ADAPTER))),
        timing: Timing::default(),
        session: OnceCell::new(),
        watch: OnceCell::new(),
        pairing: Pairing::default(),
        refusals: Refusals::default(),
    }))
}

struct BluezRadio {
    identity: Arc<Identity>,
    timing: Timing,
    session: OnceCell<Session>,
    watch: OnceCell<Watch>,
    pairing: Pairing,
    refusals: Refusals,
}

impl BluezRadio {
    async fn session(&self) -> Result<&Session, RadioError> {
        self.session
            .get_or_try_init(|| async {
                Session::new().await.map_err(dbus_error("reach bluetoothd"))
            })
            .await
    }

    /// The adapter, known to exist and to be powered.
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

    /// The adapter, ready for channels with these options.
    async fn adapter_for(&self, options: &ChannelOptions) -> Result<Adapter, RadioError> {
        let adapter = self.adapter().await?;
        self.timing.ask(adapter.name());
        let (session, epoch) = (self.session().await?, self.epoch());
        let pairing = &self.pairing;
        (pairing.prepare(session, adapter.name(), epoch, options)).await?;
        Ok(adapter)
    }
}

#[async_trait]
impl Radio for BluezRadio {
    fn name(&self) -> &str {
        self.identity.given()
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
            // Nothing can tell: the caller looks again by itself.
            Err(_) => std::future::pending().await,
        }
    }

    fn epoch(&self) -> u64 {
        self.watch.get().map_or(0, Watch::epoch) + self.identity.moves()
    }

    async fn advertise(
        &self,
        advertisement: &Advertisement,
        name: &str,
    ) -> Result<Box<dyn AdvertisingGuard>, RadioError> {
        let adapter = self.adapter().await?;
        // Linux 5.10 scans under a random address, which it cannot set while it advertises: an adapter that advertised
        // first would refuse every scan. One scan before leaves an address behind; if it fails, so will the next.
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
        let handle = to_the_end(async move { adapter.advertise(advertisement).await })
            .await
            .map_err(dbus_error("advertise"))?;
        Ok(Box::new(BluezAdvertising { _handle: handle }))
    }

    async fn scan(&self) -> Result<Box<dyn Scan>, RadioError> {
        let adapter = self.adapter().await?;
        match BluezScan::start(adapter.clone()).await {
            Ok(scan) => {
                self.refusals.on_started();
                Ok(Box::new(scan))
            }
            Err(error) => {
                self.refusals.on_failed(&adapter, &error).await;
                Err(dbus_error("scan")(error))
            }
        }
    }

    async fn name_of(&self, device: DeviceAddress) -> Option<String> {
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

    async fn disconnect(&self, peer: DeviceAddress) {
        // bluetoothd holds the connection by channels of its own, and the kernel then goes on with what it believes
        // of the old ones ("Source CID already allocated").
        let Ok(adapter) = self.adapter().await else {
            return;
        };
        if let Ok(device) = adapter.device(bluer::Address(peer.address.0)) {
            if let Err(error) = device.disconnect().await {
                tracing::debug!(%peer, %error, "the connection stays");
            }
        }
    }
}

/// Runs `asking` to its end even if the caller gives up. bluer forgets what it asked for when it is dropped in the middle:
/// bluetoothd then scans or advertises for this process for good, and refuses to start a scan that runs already.
async fn to_the_end<T: Send + 'static>(asking: impl Future<Output = T> + Send + 'static) -> T {
    match tokio::spawn(asking).await {
        Ok(answer) => answer,
        Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
        // The runtime ends, and this future with it.
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
        .map_err(dbus_error("ask the adapter's address"))?;
    let kind = adapter
        .address_type()
        .await
        .map_err(dbus_error("ask the adapter's address"))?;
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
