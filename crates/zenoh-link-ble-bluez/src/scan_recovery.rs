//! Recovers an adapter that refuses every scan. This happens when bluetoothd or a scanning program was killed: the
//! kernel and the controller then disagree about whether a scan is running, until the adapter is switched off and on.
use std::time::{Duration, Instant};

use bluer::{Adapter, ErrorKind};
use parking_lot::Mutex;

/// Time without a successful scan after which the adapter is considered stuck. A scan that outlives its bluetoothd ends
/// after 10.24 s (DISCOV_LE_TIMEOUT in hci_core.h of Linux); only a stuck adapter refuses for longer.
const STUCK_AFTER: Duration = Duration::from_secs(12);

/// Start of the current uninterrupted series of refused scans of one adapter.
#[derive(Default)]
pub(super) struct ScanRecovery(Mutex<Option<Instant>>);

impl ScanRecovery {
    pub(super) fn on_started(&self) {
        *self.0.lock() = None;
    }

    /// Switches the adapter off and on if it has refused scans for too long and no device is connected through it.
    pub(super) async fn on_failed(&self, adapter: &Adapter, error: &bluer::Error) {
        if error.kind != ErrorKind::InProgress || !self.is_stuck(Instant::now()) {
            return;
        }
        let name = adapter.name();
        if is_in_use(adapter).await {
            tracing::warn!("ble: {name} refuses to scan; it is not switched off and on because a device is connected");
            return;
        }
        tracing::warn!(
            "ble: {name} has refused to scan for {STUCK_AFTER:?}: switching it off and on"
        );
        // Runs in a separate task: the caller may drop its future, and the adapter must not stay off.
        let adapter = adapter.clone();
        let switching = tokio::spawn(async move {
            for is_on in [false, true] {
                if let Err(error) = adapter.set_powered(is_on).await {
                    tracing::warn!(
                        "ble: cannot switch the power of {}: {error}",
                        adapter.name()
                    );
                }
            }
        });
        let _ = switching.await;
    }

    fn is_stuck(&self, now: Instant) -> bool {
        let mut since = self.0.lock();
        let first = *since.get_or_insert(now);
        let is_stuck = now.duration_since(first) >= STUCK_AFTER;
        if is_stuck {
            *since = None;
        }
        is_stuck
    }
}

async fn is_in_use(adapter: &Adapter) -> bool {
    for address in adapter.device_addresses().await.unwrap_or_default() {
        if let Ok(device) = adapter.device(address) {
            if device.is_connected().await.unwrap_or(false) {
                return true;
            }
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn considers_an_adapter_stuck_after_refusing_scans_continuously() {
        let (recovery, start) = (ScanRecovery::default(), Instant::now());
        assert!(!recovery.is_stuck(start));
        assert!(!recovery.is_stuck(start + STUCK_AFTER / 2));
        recovery.on_started();
        assert!(!recovery.is_stuck(start + STUCK_AFTER));
        assert!(recovery.is_stuck(start + 2 * STUCK_AFTER));
        // The power cycle restarts the measurement.
        assert!(!recovery.is_stuck(start + 2 * STUCK_AFTER));
    }
}
