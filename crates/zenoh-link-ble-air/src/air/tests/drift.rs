//! Tests of clocks that drift, and of the shortcut for idle connections: `cargo test -p zenoh-link-ble-air --lib air::tests::drift`.
use std::time::Duration;

use super::{
    ms,
    network::{Intervals, Network},
    AirOptions, Condition,
};
use crate::arbitration::Arbitration;

/// A chain: each robot is the central of the link to the next one.
const CHAIN: [(usize, usize); 3] = [(0, 1), (1, 2), (2, 3)];
/// A hub that is the only central.
const STAR: [(usize, usize); 5] = [(0, 1), (0, 2), (0, 3), (0, 4), (0, 5)];
const HOUR: Duration = Duration::from_secs(3600);

fn options(arbitration: Arbitration, condition: Condition) -> AirOptions {
    AirOptions {
        max_clock_drift_ppm: 20,
        arbitration,
        condition,
        ..AirOptions::default()
    }
}

#[test]
fn shortcut_for_idle_connections_changes_nothing() {
    let mut drops = 0;
    for arbitration in Arbitration::ALL {
        for condition in [Condition::Desk, Condition::CrowdedHall] {
            let network = || {
                // So much drift that all overlaps occur within minutes.
                let max_clock_drift_ppm = 500;
                let options = options(arbitration, condition);
                Network::new(
                    AirOptions {
                        max_clock_drift_ppm,
                        ..options
                    },
                    &CHAIN,
                    Intervals::Equal,
                )
                .air
            };
            let (mut slow, mut fast) = (network(), network());
            let start = slow.now;
            let end = start + ms(600_000);
            for n in 1..=6000 {
                slow.poll(start + n * ms(100));
            }
            fast.poll(end);
            let events = slow.drain();
            drops += events.len();
            assert_eq!(fast.drain(), events, "{arbitration:?}, {condition}");
            assert_eq!(fast.status(), slow.status(), "{arbitration:?}, {condition}");
            let anchors = |air: &super::Air| {
                air.connections
                    .values()
                    .map(|c| c.anchor)
                    .collect::<Vec<_>>()
            };
            assert_eq!(
                anchors(&fast),
                anchors(&slow),
                "{arbitration:?}, {condition}"
            );
        }
    }
    assert!(drops > 0, "no link was lost in any model");
}

#[test]
fn equal_intervals_of_different_clocks_lose_links() {
    let mut network = Network::new(
        options(Arbitration::FirstCome, Condition::Desk),
        &CHAIN,
        Intervals::Equal,
    );
    network.run(2 * HOUR);
    assert!(network.drops() > 2, "{} drops", network.drops());
}

#[test]
fn links_of_one_central_are_never_lost() {
    let mut network = Network::new(
        options(Arbitration::FirstCome, Condition::Desk),
        &STAR,
        Intervals::Equal,
    );
    network.run(24 * HOUR);
    assert_eq!(network.drops(), 0);
    assert!(network.longest_silence() <= ms(31));
}

#[test]
fn other_models_of_arbitration_keep_the_links_and_lose_most_events() {
    // A connection with priority gets an event when six intervals are left; taking turns gives it every other event.
    for (arbitration, silence) in [
        (Arbitration::TimeoutFirst, ms(1700)..ms(2000)),
        (Arbitration::LeastRecent, ms(40)..ms(150)),
    ] {
        let mut network = Network::new(
            options(arbitration, Condition::Desk),
            &CHAIN,
            Intervals::Equal,
        );
        let mut longest = Duration::ZERO;
        for second in 1..=3600 {
            network.run(Duration::from_secs(second));
            longest = longest.max(network.longest_silence());
        }
        assert_eq!(network.drops(), 0, "{arbitration:?}");
        assert!(silence.contains(&longest), "{arbitration:?}: {longest:?}");
    }
}
