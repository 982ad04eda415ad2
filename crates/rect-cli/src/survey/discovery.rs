//! Measures how soon the other robot is discovered by its Bluetooth advertisements, and how strong they are.
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use rect::Name;
use tokio::time::timeout;
use zenoh_link_ble::locator::is_simulated;
use zenoh_link_ble_radio::{Radio, RadioError};

use super::document::Discovery;

/// How often it is measured.
const ROUNDS: usize = 5;
/// After this time, the other robot counts as out of range.
const LIMIT: Duration = Duration::from_secs(10);

/// Scans several times, each time until the first advertisement of `other`.
pub async fn measure(adapter: &str, other: &Name) -> Discovery {
    let mut discovery = Discovery::default();
    let mut signals = Vec::new();
    let opened: Result<Arc<dyn Radio>, _> = match is_simulated(adapter) {
        true => zenoh_link_ble_air::radio(adapter),
        false => zenoh_link_ble_bluez::radio(Some(adapter)),
    };
    let radio = match opened {
        Ok(radio) => radio,
        Err(error) => {
            discovery.error = Some(error.to_string());
            return discovery;
        }
    };
    for _ in 0..ROUNDS {
        let began = Instant::now();
        match timeout(LIMIT, discover(&*radio, other)).await {
            Ok(Ok(signal_dbm)) => {
                discovery.seconds.push(began.elapsed().as_secs_f64());
                signals.extend(signal_dbm);
            }
            Ok(Err(error)) => {
                discovery.error = Some(error.to_string());
                break;
            }
            Err(_elapsed) => {
                let limit_s = LIMIT.as_secs();
                discovery.error = Some(format!("no advertisement within {limit_s} s"));
                break;
            }
        }
    }
    signals.sort_unstable();
    discovery.signal_dbm = signals.get(signals.len() / 2).copied();
    discovery
}

/// Scans until an advertisement of `other` arrives, and returns its signal strength.
async fn discover(radio: &dyn Radio, other: &Name) -> Result<Option<i16>, RadioError> {
    let mut scan = radio.scan().await?;
    loop {
        let report = scan.next().await?;
        if report.advertisement.is_some()
            && radio.device_name(report.device).await.as_deref() == Some(other.as_str())
        {
            return Ok(report.rssi_dbm);
        }
    }
}
