//! Compares the collisions of advertisements with theory: `cargo test -p zenoh-link-ble-air --lib air::tests::collisions`.
use std::time::Duration;
use zenoh_link_ble_radio::advertisement::Advertisement;

use super::{ms, psm, request, Air, AirOptions, Condition};

use crate::{air::advertising_channel::packet, message::Command};

/// Returns the share of packets that collide if `advertisers` send to one scanner.
fn collision_rate(advertisers: u32, advertising_interval: Duration) -> f64 {
    let mut air = Air::new(AirOptions {
        condition: Condition::Desk,
        advertising_interval,
        ..AirOptions::default()
    });
    let scanner = air.attach("sim-scanner", ms(0)).expect("attaches");
    let scan = Command::Scan(true);
    air.command(scanner, scan, ms(0)).expect("scans");
    for n in 0..advertisers {
        // Switched on one after the other, at times that have nothing to do with the interval.
        let at = Duration::from_micros(u64::from(n) * 7919);
        let id = air.attach(&format!("sim-{n}"), at).expect("attaches");
        let advertise = Command::Advertise {
            request: request(1),
            advertisement: Advertisement {
                psm: psm(),
                plain: false,
                name_hash: 0,
                fleet_hash: 0,
                incarnation: 0,
            },
            name: format!("robot-{n}"),
        };
        air.command(id, advertise, at).expect("advertises");
    }
    air.poll(ms(10_000));
    let before = air.collisions;
    // Long enough for the random delays to bring every two advertisers together many times.
    air.poll(ms(10_000) + 150_000 / advertisers * advertising_interval);
    let packets = air.collisions.packets - before.packets;
    (air.collisions.collided - before.collided) as f64 / packets as f64
}

#[test]
fn collision_rate_follows_the_aloha_formula() {
    for (advertisers, interval_ms) in [
        (10, 100),
        (20, 100),
        (45, 100),
        (70, 100),
        (100, 100),
        (45, 152),
        // More than 200 advertisers, for which 0.22 to 0.33 is published (Sensors 2020, 20, 107).
        (220, 500),
    ] {
        let rate = collision_rate(advertisers, ms(interval_ms));
        // A packet is received if none of the others begins within its airtime before or after it starts. The random
        // delay adds 5 ms on average.
        let busy = 2.0 * packet().as_secs_f64() / (0.001 * (interval_ms as f64 + 5.0));
        let expected = 1.0 - (1.0 - busy).powi(advertisers as i32 - 1);
        println!("collisions: {advertisers} advertisers, {interval_ms} ms: {rate:.3}, formula {expected:.3}");
        assert!(
            (rate / expected - 1.0).abs() < 0.1,
            "{advertisers} advertisers, {interval_ms} ms: {rate:.3}, formula {expected:.3}"
        );
        if advertisers > 200 {
            assert!((0.22..0.33).contains(&rate), "{rate:.3}");
        }
    }
}
