//! Measures how long robots need to discover each other and to link, by the number of robots and by the settings of
//! advertising and scanning. The figures are in docs/concepts/radio.md.
use std::{collections::BTreeMap, sync::Arc, time::Duration};

use rand_pcg::{rand_core::SeedableRng, Pcg32};
use tokio::time::Instant;
use zenoh_link_ble_air::{AirOptions, Condition};
use zenoh_link_ble_radio::Radio;

use crate::shared::hall::{Finding, Hall, ROBOTS_OF_A_FLEET};

/// Settings of advertising and scanning.
#[derive(Clone, Copy, Debug)]
struct Settings {
    name: &'static str,
    advertising_ms: u64,
    scan_interval_us: u64,
    scan_window_us: u64,
}

/// The defaults of BlueZ.
const BLUEZ: Settings = Settings {
    name: "BlueZ",
    advertising_ms: 1280,
    scan_interval_us: 22_500,
    scan_window_us: 11_250,
};
/// RECT's settings before scanning was tuned.
const BEFORE: Settings = Settings {
    name: "RECT before",
    advertising_ms: 100,
    ..BLUEZ
};
/// The settings of config/bluetooth.conf. A quarter of the time remains for Wi-Fi on a shared radio.
const RECT: Settings = Settings {
    name: "RECT",
    scan_interval_us: 60_000,
    scan_window_us: 45_000,
    ..BEFORE
};

/// The result of one run.
struct Crowd {
    /// Time until a bystander has discovered each robot, sorted.
    discovered: Vec<Duration>,
    /// Time until each pair of a fleet is linked, sorted.
    linked: Vec<Duration>,
}

/// Switches all robots on within half a second.
async fn crowd(fleets: usize, settings: Settings, seed: u64) -> Crowd {
    let options = AirOptions {
        seed,
        condition: Condition::CrowdedHall,
        advertising_interval: Duration::from_millis(settings.advertising_ms),
        scan_interval: Duration::from_micros(settings.scan_interval_us),
        scan_window: Duration::from_micros(settings.scan_window_us),
        ..AirOptions::default()
    };
    let mut rng = Pcg32::seed_from_u64(seed);
    let hall = Hall::new(fleets, options, &mut rng);
    let start = Instant::now();
    hall.switch_on(Finding::ByName, &mut rng, 500);
    let bystander: Arc<dyn Radio> = hall.air.radio("sim-bystander").await.expect("attaches");
    let mut scan = bystander.scan().await.expect("scans");
    let mut discovered = BTreeMap::new();
    while discovered.len() < fleets * ROBOTS_OF_A_FLEET {
        let report = scan.next().await.expect("the adapter is on");
        discovered
            .entry(report.device.address)
            .or_insert(start.elapsed());
    }
    drop(scan);
    let mut discovered: Vec<_> = discovered.into_values().collect();
    discovered.sort_unstable();
    let linked = hall.all_linked(start).await;
    Crowd { discovered, linked }
}

fn median(sorted: &[Duration]) -> f64 {
    sorted[sorted.len() / 2].as_secs_f64()
}

fn last(sorted: &[Duration]) -> f64 {
    sorted.last().expect("not empty").as_secs_f64()
}

async fn measure(fleets: usize, settings: Settings, seed: u64) -> Crowd {
    let crowd = crowd(fleets, settings, seed).await;
    println!(
        "crowd: {} robots; {}; seed {seed}; discovered {:.1} s, all {:.1} s; linked {:.1} s, all {:.1} s",
        fleets * ROBOTS_OF_A_FLEET,
        settings.name,
        median(&crowd.discovered),
        last(&crowd.discovered),
        median(&crowd.linked),
        last(&crowd.linked)
    );
    crowd
}

#[tokio::test(start_paused = true)]
async fn fleets_of_45_robots_link_within_five_seconds() {
    for seed in 1..=5 {
        let crowd = measure(15, RECT, seed).await;
        assert!(last(&crowd.linked) < 5.0, "seed {seed}");
    }
}

#[tokio::test(start_paused = true)]
async fn tuned_settings_link_crowds_sooner() {
    for fleets in [1, 3, 15, 33] {
        let mut times = Vec::new();
        for settings in [BLUEZ, BEFORE, RECT] {
            times.push(last(&measure(fleets, settings, 29).await.linked));
        }
        assert!(times[2] < times[0] / 2.0, "{fleets} fleets: {times:?}");
        // Runs differ, because tasks run in random order.
        let limit = if fleets <= 15 { 5.0 } else { 10.0 };
        assert!(times[2] < limit, "{fleets} fleets: {times:?}");
    }
}
