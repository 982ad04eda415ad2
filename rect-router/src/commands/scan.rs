//! Owns `rect-router scan`: which robots are heard by Bluetooth.
use std::{collections::BTreeMap, time::Duration};

use rect::terminal::{self, Table};
use serde_json::{json, Value};
use tokio::time::{timeout_at, Instant};
use zenoh_link::ble::{
    advertisement::Advertisement,
    locator::is_simulated,
    radio::{bluez, sim, Radio, RadioError, Sighting},
};

use super::{Failure, ScanArgs};

pub fn run(args: &ScanArgs) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()?;
    let heard = runtime.block_on(heard(args))?;
    if args.json {
        return Ok(terminal::json(&heard)?);
    }
    let mut shown = Table::new(&["ADDRESS", "NAME", "FLEET", "PSM", "SIGNAL"]);
    for robot in &heard {
        let text = |key: &str| match &robot[key] {
            Value::Null => String::new(),
            Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        let signal = robot["rssi_dbm"].as_i64();
        let signal = signal.map(|dbm| format!("{dbm} dBm"));
        shown.row(vec![
            text("address").into(),
            text("name").into(),
            text("fleet").into(),
            text("psm").into(),
            signal.into(),
        ]);
    }
    shown.print();
    rect::outln!("{} heard within {} s", heard.len(), args.seconds);
    Ok(())
}

/// Each robot once, as heard last, by address.
async fn heard(args: &ScanArgs) -> Result<Vec<Value>, RadioError> {
    let radio = match &args.adapter {
        adapter if is_simulated(adapter) => sim::radio(adapter)?,
        adapter => bluez::radio(Some(adapter))?,
    };
    let mut scan = radio.scan().await?;
    let end = Instant::now() + Duration::from_secs(args.seconds);
    let mut heard = BTreeMap::new();
    while let Ok(sighting) = timeout_at(end, scan.next()).await {
        let sighting = sighting?;
        heard.insert(sighting.device.to_string(), sighting);
    }
    let mut robots = Vec::new();
    for (address, sighting) in heard {
        if let Some(advertisement) = sighting.advertisement {
            robots.push(robot(&*radio, &args.fleet, address, &advertisement, &sighting).await);
        }
    }
    Ok(robots)
}

async fn robot(
    radio: &dyn Radio,
    fleet: &str,
    address: String,
    advertisement: &Advertisement,
    sighting: &Sighting,
) -> Value {
    let fleet = match advertisement.fleet_hash {
        0 => None,
        hash if hash == Advertisement::hash_of_fleet(fleet) => Some(fleet),
        _ => Some("another"),
    };
    json!({
        "address": address,
        "name": radio.name_of(sighting.device).await,
        "fleet": fleet,
        "psm": advertisement.psm.number(),
        "rssi_dbm": sighting.rssi_dbm,
    })
}
