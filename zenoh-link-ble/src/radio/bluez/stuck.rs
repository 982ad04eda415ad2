//! Owns the way out for an adapter that refuses every scan: seen when bluetoothd or a scanning program was killed, after
//! which kernel and controller disagree about whether a scan runs, until the adapter is switched off and on.
use std::time::{Duration, Instant};

use bluer::{Adapter, ErrorKind};
use parking_lot::Mutex;

/// A scan that outlives its bluetoothd ends by itself after 10.24 s (DISCOV_LE_TIMEOUT in Linux' hci_core.h); only an
/// adapter that is stuck refuses for longer.
const STUCK_AFTER: Duration = Duration::from_secs(12);

/// Since when one adapter refuses scans without a break.
#[derive(Default)]
pub(super) struct Refusals(Mutex<Option<Instant>>);

impl Refusals {
    pub(super) fn on_started(&self) {
        *self.0.lock() = None;
    }

    /// Switches the adapter off and on if it has refused for too long and nobody is connected by it.
    pub(super) async fn on_failed(&self, adapter: &Adapter, error: &bluer::Error) {
        if error.kind != ErrorKind::InProgress || !self.is_stuck(Instant::now()) {
            return;
        }
        let name = adapter.name();
        if is_in_use(adapter).await {
            tracing::warn!("ble: {name} refuses to scan; it is not switched off and on, as a device is connected");
            return;
        }
        tracing::warn!("ble: {name} refuses to scan for {STUCK_AFTER:?}: switching it off and on");
        // A task of its own: whoever wanted to scan may give up in between, and the adapter must not stay off.
        let adapter = adapter.clone();
        let switching = tokio::spawn(async move {
            for is_on in [false, true] {
                if let Err(error) = adapter.set_powered(is_on).await {
                    tracing::warn!("ble: {} could not be switched: {error}", adapter.name());
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
    fn an_adapter_is_stuck_after_a_while_of_refusals_without_a_break() {
        let (refusals, start) = (Refusals::default(), Instant::now());
        assert!(!refusals.is_stuck(start));
        assert!(!refusals.is_stuck(start + STUCK_AFTER / 2));
        refusals.on_started();
        assert!(!refusals.is_stuck(start + STUCK_AFTER));
        assert!(refusals.is_stuck(start + 2 * STUCK_AFTER));
        // Then it has its chance.
        assert!(!refusals.is_stuck(start + 2 * STUCK_AFTER));
    }
}
