//! Owns finding another robot of this one's name: two of one name would be dialled by turns.
use std::{sync::Arc, time::Duration};

use tokio_util::task::AbortOnDropHandle;

use crate::{adapter::Adapter, address::DeviceAddress, error::BleError};

/// How long to listen for another robot of the same name before taking it: several of RECT's advertising intervals
/// (`config/bluetooth.conf`), and short, since dialling waits for it.
const SEARCH: Duration = Duration::from_millis(500);
/// How long to go on listening for it afterwards: longer than BlueZ's own interval of 1.28 s.
const WATCH: Duration = Duration::from_millis(2000);

/// Ends with the address of another robot of this one's name, if one is heard.
pub(crate) type NameSearch = AbortOnDropHandle<Result<Option<DeviceAddress>, BleError>>;

/// What tells another robot of this one's name from this one.
pub(crate) struct Namesake {
    pub(crate) adapter: Arc<Adapter>,
    pub(crate) name: String,
    /// This run's: what is left of an earlier run's advertisement is no other robot's.
    pub(crate) incarnation: u16,
}

impl Namesake {
    /// Listens for a moment, beside whatever else is going on.
    pub(crate) fn search(self) -> NameSearch {
        AbortOnDropHandle::new(tokio::spawn(async move { self.heard_within(SEARCH).await }))
    }

    /// Listens for long enough to hear one that advertises as rarely as BlueZ does by itself.
    pub(crate) async fn watch(self) -> Result<Option<DeviceAddress>, BleError> {
        self.heard_within(WATCH).await
    }

    async fn heard_within(&self, limit: Duration) -> Result<Option<DeviceAddress>, BleError> {
        let own = self.adapter.radio.address().await?;
        let same_name = self.adapter.scanner.find(|sighting| {
            let other = sighting.advertisement.as_ref()?;
            let clash = other.is_of(&self.name)
                && other.incarnation != self.incarnation
                && sighting.device.address != own.address;
            clash.then_some(sighting.device)
        });
        let heard = tokio::time::timeout(limit, same_name).await;
        Ok(heard.ok().transpose()?)
    }
}
