//! Searches for another robot with this node's name. If two robots had the same name, peers would dial either of them.
use std::{sync::Arc, time::Duration};

use tokio_util::task::AbortOnDropHandle;
use zenoh_link_ble_radio::address::DeviceAddress;

use crate::{adapter::Adapter, error::BleError};

/// How long to scan for another robot with the same name before this node dials: several of RECT's advertising
/// intervals (`config/bluetooth.conf`), but short, because dialling waits for the result.
const SEARCH: Duration = Duration::from_millis(500);
/// How long to continue the scan afterwards: longer than BlueZ's default advertising interval of 1.28 s.
const WATCH: Duration = Duration::from_millis(2000);

/// A running search, which returns the address of another robot with this node's name if one is found.
pub(crate) type NameSearch = AbortOnDropHandle<Result<Option<DeviceAddress>, BleError>>;

/// A check for another robot with this node's name.
pub(crate) struct NameConflictCheck {
    pub(crate) adapter: Arc<Adapter>,
    pub(crate) name: String,
    /// Incarnation of this run. Advertisements with this incarnation, or with the adapter's address, are this node's own.
    pub(crate) incarnation: u16,
}

impl NameConflictCheck {
    /// Starts a short scan in the background.
    pub(crate) fn search(self) -> NameSearch {
        AbortOnDropHandle::new(tokio::spawn(async move { self.find_within(SEARCH).await }))
    }

    /// Scans long enough to find a robot that advertises at BlueZ's default interval.
    pub(crate) async fn watch(self) -> Result<Option<DeviceAddress>, BleError> {
        self.find_within(WATCH).await
    }

    /// Returns the address of another robot with this node's name if it is discovered within `limit`.
    async fn find_within(&self, limit: Duration) -> Result<Option<DeviceAddress>, BleError> {
        let own = self.adapter.radio.address().await?;
        let same_name = self.adapter.scanner.find(|report| {
            let other = report.advertisement.as_ref()?;
            let is_conflict = other.matches_name(&self.name)
                && other.incarnation != self.incarnation
                && report.device.address != own.address;
            is_conflict.then_some(report.device)
        });
        let found = tokio::time::timeout(limit, same_name).await;
        Ok(found.ok().transpose()?)
    }
}
