//! Implements `rect-router scan`: shows the robots whose Bluetooth advertisements are received.
use std::{collections::BTreeMap, time::Duration};

use rect_terminal::{self as terminal, Table};
use serde_json::{json, Value};
use tokio::time::{timeout_at, Instant};
use zenoh_link_ble::locator::is_simulated;
use zenoh_link_ble_radio::{advertisement::Advertisement, AdvertisingReport, Radio, RadioError};

use super::Failure;
use crate::args::ScanArgs;

/// Scans and prints the discovered robots.
///
/// # Errors
/// Fails if the adapter is missing or cannot scan.
pub fn run(args: &ScanArgs) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()?;
    let discovered = runtime.block_on(discovered(args))?;
    if args.json {
        return Ok(terminal::json(&discovered)?);
    }
    let mut table = Table::new(&["ADDRESS", "NAME", "FLEET", "PSM", "SIGNAL"]);
    for robot in &discovered {
        let text = |key: &str| match &robot[key] {
            Value::Null => String::new(),
            Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        let signal = robot["rssi_dbm"].as_i64();
        let signal = signal.map(|dbm| format!("{dbm} dBm"));
        table.row(vec![
            text("address").into(),
            text("name").into(),
            text("fleet").into(),
            text("psm").into(),
            signal.into(),
        ]);
    }
    table.print();
    rect_terminal::outln!("{} discovered within {} s", discovered.len(), args.seconds);
    Ok(())
}

/// Scans for robots and returns each one once, with its latest advertisement, sorted by address.
async fn discovered(args: &ScanArgs) -> Result<Vec<Value>, RadioError> {
    let radio = match &args.adapter {
        adapter if is_simulated(adapter) => zenoh_link_ble_air::radio(adapter)?,
        adapter => zenoh_link_ble_bluez::radio(Some(adapter))?,
    };
    let mut scan = radio.scan().await?;
    let end = Instant::now() + Duration::from_secs(args.seconds);
    let mut reports = BTreeMap::new();
    while let Ok(report) = timeout_at(end, scan.next()).await {
        let report = report?;
        reports.insert(report.device.to_string(), report);
    }
    let mut robots = Vec::new();
    for (address, report) in reports {
        if let Some(advertisement) = report.advertisement {
            robots.push(robot(&*radio, &args.fleet, address, &advertisement, &report).await);
        }
    }
    Ok(robots)
}

async fn robot(
    radio: &dyn Radio,
    fleet: &str,
    address: String,
    advertisement: &Advertisement,
    report: &AdvertisingReport,
) -> Value {
    let fleet = match advertisement.fleet_hash {
        0 => None,
        hash if hash == Advertisement::hash_of_fleet(fleet) => Some(fleet),
        _ => Some("another"),
    };
    json!({
        "address": address,
        "name": radio.device_name(report.device).await,
        "fleet": fleet,
        "psm": advertisement.psm.number(),
        "rssi_dbm": report.rssi_dbm,
    })
}
